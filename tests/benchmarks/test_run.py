"""A whole run, its page and its command: the document's form, and what it says of peers that are not here."""

import copy
import json
import sys

import pytest
from benchmarks import bench_page as page
from benchmarks.bench import __main__ as command
from benchmarks.bench import acceptance, peers, tables
from benchmarks.bench.entries import ACCURATE
from benchmarks.bench.run import run
from benchmarks.bench.tables import Table, number

from tests.benchmarks.tiny import TINY, tiny_document

SCHEMA = {
    "document": "format mode accuracy rounds machine peers systems batches rollouts trunks derivatives distribution"
    " growth compile bars",
    "machine": "processor cores lanes features system python versions",
    "system": "name arms joints states operations entries skipped",
    "entry": "name library note floor microseconds lower_quartile upper_quartile error wrench_error accurate ratios",
    "batch": "size microseconds lower_quartile upper_quartile error ratios",
    "stepping": "name library note microseconds lower_quartile upper_quartile steps_per_second gap ratios",
    "trunk": "name operations call bound batch peers",
    "on a trunk": "name library note microseconds lower_quartile upper_quartile error wrench_error ratios",
    "derivative": "system what way library note microseconds lower_quartile upper_quartile error ratios",
    "distribution": "kind name library microseconds lower_quartile upper_quartile ratio",
    "growth": "larger smaller ratio",
    "compile": "system cold cached",
    "bar": "what sense goal value met note",
}


@pytest.mark.slow
def test_schema():
    """The document has these keys and no others; another program may rely on them."""
    document = tiny_document()
    rows = {
        "document": [document],
        "machine": [document["machine"]],
        "system": document["systems"],
        "entry": [entry for record in document["systems"] for entry in record["entries"]],
        "batch": document["batches"]["sizes"],
        "stepping": document["rollouts"]["entries"],
        "trunk": document["trunks"],
        "on a trunk": [row for r in document["trunks"] for row in (r["call"], r["bound"], r["batch"], *r["peers"])],
        "derivative": document["derivatives"],
        "distribution": document["distribution"],
        "growth": document["growth"],
        "compile": document["compile"],
        "bar": document["bars"],
    }
    for kind, keys in SCHEMA.items():
        assert rows[kind], kind
        for row in rows[kind]:
            assert list(row) == keys.split(), kind
    assert document["format"] == 1


@pytest.mark.slow
def test_is_plain_json():
    """Nothing of NumPy, nothing that JSON does not know."""
    document = tiny_document()
    assert json.loads(json.dumps(document, allow_nan=False)) == document


@pytest.mark.slow
def test_ours_is_accurate():
    """Machine code, bound, batched: the peers' answers."""
    document = tiny_document()
    ours = [e for record in document["systems"] for e in record["entries"] if e["library"] == "holdfast"]
    assert all(entry["accurate"] and entry["wrench_error"] <= 1e-9 for entry in ours)
    assert all(row["error"] <= 1e-9 for row in document["batches"]["sizes"])
    agreement = document["bars"][-1]
    assert agreement["met"] is True


@pytest.mark.slow
def test_trunks():
    """On three joints and on a floating base: Pinocchio's answers, one call or many; beside ours without a trunk."""
    for record in tiny_document()["trunks"]:
        (peer,) = record["peers"]
        assert peer["name"] == "constraintDynamics, free" and peer["ratios"].keys() == {"call", "bound", "batch"}
        for ours in (record["call"], record["bound"], record["batch"]):
            assert ours["error"] <= ACCURATE and ours["wrench_error"] <= ACCURATE
            assert ours["ratios"].keys() == {"2 x 7"}


@pytest.mark.slow
def test_derivatives():
    """Products and the matrix, bound, called and in a batch, as exact as the reference; Pinocchio's over ours."""
    rows = {(row["library"], row["what"], row["way"]): row for row in tiny_document()["derivatives"]}
    ways = [("VJP", "bound"), ("VJP", "batch"), ("JVP", "bound"), ("JVP", "batch")]
    ways += [("Jacobian", way) for way in ("call", "bound", "batch")]
    for what, way in ways:
        row = rows["holdfast", what, way]
        assert row["error"] <= 1e-11 and [*row["ratios"]] == [f"forward dynamics, {way}"]
    theirs = rows["pinocchio", "Jacobian", "call"]
    assert theirs["error"] <= ACCURATE
    assert theirs["ratios"].keys() == {f"Jacobian, {way}" for way in ("call", "bound", "batch")}
    table = tables.derivatives(tiny_document())
    assert len(table.rows) == len(rows) and {len(row) for row in table.rows} == {len(table.header)}


@pytest.mark.slow
def test_rollouts():
    """Every scheme and rival; ours close their grasps, MuJoCo's are soft; the checks are read from the fastest."""
    document = tiny_document()
    rows = {row["name"]: row for row in document["rollouts"]["entries"]}
    assert {"rk4, 4 systems", "midpoint, 4 systems", "mj_step, Euler, default welds"} <= rows.keys()
    assert all((row["gap"] <= 1e-12) == (row["library"] == "holdfast") for row in rows.values())
    assert rows["rk4, 4 systems"]["ratios"]["rk4, 4 systems"] == 1.0
    found = {check["what"]: check for check in document["bars"]}
    check = found["2 x 7, rollouts by RK4: steps a second, one thread"]
    assert check["value"] == rows["rk4, 4 systems"]["steps_per_second"]
    assert "mj_step, Euler" in found["2 x 7, a step by RK4: fastest mj_step by Euler / ours"]["note"]


@pytest.mark.slow
def test_checks_not_measured():
    """A check whose system was not run has no value and is neither met nor missed."""
    found = {check["what"]: check for check in tiny_document()["bars"]}
    assert found["64 x 7: lcaba / ours"]["value"] is None
    assert found["64 x 7: lcaba / ours"]["met"] is None
    assert isinstance(found["2 x 7: operations"]["met"], bool)
    assert len(found) == len(acceptance.CHECKS)


@pytest.mark.long
def test_absent_peers_are_named(monkeypatch):
    """Without the other libraries the run goes on and says what it misses, and how to get it."""

    for peer in ("pinocchio", "mujoco"):
        monkeypatch.setitem(sys.modules, peer, None)  # importing it now raises ImportError
    document = run(TINY)
    assert set(document["peers"]) == {"pinocchio", "mujoco"}
    for name, package in (("pinocchio", "pin"), ("mujoco", "mujoco-core")):
        reason = document["peers"][name]["absent"]
        assert name in reason
        assert reason.endswith(f"; try pip install {package}")
    assert {e["library"] for record in document["systems"] for e in record["entries"]} == {"holdfast"}
    assert [line.split(":")[0] for line in tables.absences(document)] == ["pinocchio", "mujoco"]
    rivals = [check for check in document["bars"] if "Pinocchio" in check["what"] or "mj_forward" in check["what"]]
    assert rivals
    assert all(check["met"] is None for check in rivals)


def test_a_module_of_another_kind(monkeypatch):
    """A package that only shares the name is no peer."""
    monkeypatch.setitem(sys.modules, "mujoco", json)
    assert "has no mj_forward" in peers.found()["mujoco"]["absent"]


@pytest.mark.parametrize("library", ["pinocchio", "mujoco"])
def test_fastest(library):
    """The fastest accurate way counts; where none is accurate, the fastest of all; floors never."""

    def entry(name, ratio, accurate, floor=False):
        ratios = {"forward_dynamics": ratio}
        return {"library": library, "name": name, "ratios": ratios, "accurate": accurate, "floor": floor}

    rough, exact, floor = entry("rough", 1.0, False), entry("exact", 3.0, True), entry("floor", 0.1, False, True)
    slower = entry("exact, slower", 4.0, True)
    assert acceptance.fastest({"entries": [rough, slower, exact, floor]}, library) is exact
    assert acceptance.fastest({"entries": [rough, floor]}, library) is rough
    assert acceptance.fastest({"entries": [floor]}, library) is None
    assert acceptance.fastest({"entries": [slower, exact, rough]}, library, "rough") is rough


@pytest.mark.slow
def test_readme_is_a_pure_function_of_the_document():
    """The same document gives the same text and is left as it was; its numbers are the document's."""
    document = tiny_document()
    before = copy.deepcopy(document)
    text = page.readme(document)
    assert page.readme(copy.deepcopy(before)) == text
    assert document == before
    own = document["systems"][0]["entries"][0]
    assert f"| 2 x 7 | {number(own['microseconds'])} us |" in text
    assert "| 3 x 6 |" not in text  # not among the sizes of the README


@pytest.mark.slow
def test_page_has_everything():
    """Every system, entry and version is on the page; no date."""
    document = tiny_document()
    text = page.page(document)
    for record in document["systems"]:
        assert record["name"] in text
        for entry in record["entries"]:
            assert f"{entry['library']} {entry['name']}" in text
    for peer in document["peers"].values():
        assert peer.get("version", "Not compared") in text
    assert document["machine"]["processor"] in text
    assert "images/bench_arms.png" in text
    both = page.page(document, document)
    assert both.startswith(text[: text.index("## Registers")]) and "### Acceptance checks, AVX2" in both


@pytest.mark.slow
def test_absent_and_skipped_are_on_the_page():
    """What was not compared is said, with the reason."""
    document = copy.deepcopy(tiny_document())
    document["peers"]["mujoco"] = {"absent": "not here; try pip install mujoco-core"}
    document["systems"][0]["skipped"] = [{"library": "pinocchio", "name": "lcaba, free", "reason": "needs 3 GB"}]
    text = page.page(document)
    assert "mujoco: not compared: not here; try pip install mujoco-core" in text
    assert "pinocchio lcaba, free at 2 x 7: skipped: needs 3 GB" in text


def test_between_the_markers():
    """Only what is between the markers changes, however often."""
    text = f"above\n{page.BEGIN}\nold\n{page.END}\nbelow\n"
    once = page.with_table(text, "new\n")
    assert once == f"above\n{page.BEGIN}\nnew\n{page.END}\nbelow\n"
    assert page.with_table(once, "new\n") == once
    with pytest.raises(ValueError, match="bench:begin"):
        page.with_table("no markers", "new\n")


def test_markdown_and_cut():
    """A table as Markdown, and cut into narrower ones whose last has the notes."""
    table = Table("t", ["x", "a", "b", "c"], [["1", "2", "3", "4"]], ["note"])
    assert table.markdown() == "| x | a | b | c |\n| --- | --- | --- | --- |\n| 1 | 2 | 3 | 4 |\n\nnote\n"
    left, right = table.cut(2)
    assert (left.header, left.rows, left.notes) == (["x", "a", "b"], [["1", "2", "3"]], [])
    assert (right.header, right.rows, right.notes) == (["x", "c"], [["1", "4"]], ["note"])


def test_numbers():
    """About three digits."""
    assert [number(x) for x in (0.1234, 1.234, 12.34, 123.4, 12345.6)] == ["0.123", "1.23", "12.3", "123", "12,346"]


@pytest.mark.slow
def test_disturbed_times_are_marked():
    """Quartiles that are far apart tell that others used the machine."""
    document = copy.deepcopy(tiny_document())
    entry = document["systems"][0]["entries"][0]
    entry |= {"lower_quartile": 1.0, "microseconds": 1.5, "upper_quartile": 2.0}
    assert tables.times(document).rows[0][1] == "~1.50"


@pytest.fixture
def plots():
    """The module, which needs matplotlib."""
    pytest.importorskip("matplotlib", reason="needs matplotlib: pip install 'holdfast[plot]'")
    from benchmarks import bench_plots as plots

    return plots


@pytest.mark.slow
def test_figures(plots, tmp_path):
    """Three pictures, log-log, our line in each."""
    names = plots.save(tiny_document(), tmp_path)
    assert sorted(names) == ["bench_arms.png", "bench_batch.png", "bench_links.png"]
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in names)
    figure = plots.batch_curve(tiny_document())
    (panel,) = figure.axes
    assert (panel.get_xscale(), panel.get_yscale()) == ("log", "log")
    assert any(line.get_label().startswith("holdfast") for line in panel.lines)


@pytest.fixture
def quickly(monkeypatch):
    """The command shows the tiny run; returns the plans it was asked for."""
    plans = []

    def run(plan, report):
        plans.append(plan)
        report("something", 0.5)
        return tiny_document()

    monkeypatch.setattr(command, "run", run)
    return plans


@pytest.mark.slow
def test_json_only_on_stdout(quickly, capsys):
    """One document on stdout, nothing else."""
    assert command.main(["--quick", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == tiny_document()
    assert err == "measuring: something\n"
    assert quickly == [command.QUICK]


@pytest.mark.slow
def test_tables(quickly, capsys):
    """Ratios before times, then the acceptance checks; every entry is named."""
    assert command.main([]) == 0
    out, err = capsys.readouterr()
    assert err == "measuring: something\n"
    assert quickly == [command.FULL]
    assert out.index("Time over ours") < out.index("Microseconds per evaluation") < out.index("Acceptance checks")
    for entry in tiny_document()["systems"][0]["entries"]:
        assert f"{entry['library']} {entry['name']}" in out
    assert "the ratios travel better" in out


@pytest.mark.slow
def test_absent_peer(quickly, capsys, monkeypatch):
    """What was not compared is said below the tables."""
    monkeypatch.setitem(tiny_document()["peers"], "mujoco", {"absent": "No module named 'mujoco'; try pip install x"})
    assert command.main(["--quick"]) == 0
    assert "mujoco: not compared: No module named 'mujoco'; try pip install x" in capsys.readouterr().out


@pytest.mark.long
def test_quick_run(capsys):
    """The real thing, small."""
    assert command.main(["--quick", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["mode"] == "quick"
    assert [record["name"] for record in document["systems"]] == ["2 x 7", "4 x 7", "2 x 24"]


def test_plans():
    """The full run has the sizes of every acceptance check."""
    names = {f"{arms} x {joints}" for arms, joints in command.FULL.systems}
    assert {"2 x 7", "16 x 7", "64 x 7", "2 x 96"} <= names
    assert set(command.QUICK.systems) < set(command.FULL.systems)
    assert TINY.mode == "tiny"
