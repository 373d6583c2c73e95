"""How masses are weighed with the forces of two arms, on readings of sensors whose errors are known."""

import numpy as np
import pytest
from benchmarks.measured_calibration import FITTED, NEEDED, WAYS, G, fit, mass_of, readings, runs_of

SCALES, SHARE, OFFSET = (0.6, 1.1), -0.15, -4.0


def run(mass, seed, samples=900):
    """Return columns of a run in which two arms lift a mass, with a squeeze and a split that vary."""
    random, t = np.random.default_rng(seed), np.linspace(0.0, 20.0, samples)
    squeeze = 80.0 + 20.0 * np.sin(0.6 * t + seed)
    left = -0.5 * mass * G + 8.0 * np.sin(0.4 * t)
    known = {"force_L_z": left / SCALES[0], "normal_force_L": squeeze + 1.0, "normal_force_R": squeeze - 1.0}
    known["force_R_z"] = (-mass * G - left - SHARE * squeeze - OFFSET) / SCALES[1]
    known["tcp_L_z"] = np.where(t < 4.0, 0.0, 0.3)
    return {name: known.get(name, random.normal(size=samples)) for name in NEEDED}


def written(folder, name, columns, titles=lambda name: name):
    """Write columns as a file."""
    rows = np.column_stack(list(columns.values()))
    head = ",".join(map(titles, columns))
    np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header=head, comments="")


def test_scales_offset_and_share_of_the_squeeze_are_found_and_weigh_another_mass():
    way = WAYS["a scale for each sensor, a share of the squeeze, and an offset"]
    c = fit(way, [(readings(run(mass, seed)), mass) for mass, seed in ((2.4, 0), (4.4, 1))])
    assert c == pytest.approx([*SCALES, SHARE, OFFSET])
    assert way(readings(run(7.1, 2))) @ c / -G == pytest.approx(7.1)


def test_a_scale_of_the_sum_meets_the_means_of_the_runs_it_is_fitted_on():
    given = [(readings(run(mass, seed)), mass) for mass, seed in ((2.4, 0), (4.4, 1))]
    for way in WAYS.values():
        c = fit(way, given)
        assert [float((way(x) @ c / -G).mean()) for x, _ in given] == pytest.approx([2.4, 4.4])


def test_files_of_other_masses_and_titles_are_read_and_others_named(tmp_path, capsys):
    for name, mass in zip(FITTED, (2.4, 4.4), strict=True):
        written(tmp_path, name, run(mass, 0))
    written(tmp_path, "dual_ur5e_3,4kg_again", run(3.4, 3), titles=lambda name: f" {name.upper()} [N]")
    short = run(1.4, 4)
    del short["force_R_z"]
    written(tmp_path, "dual_ur5e_1.4kg", short)
    written(tmp_path, "dual_ur5e_0.5kg", {name: x[:150] for name, x in run(0.5, 5).items()})
    (tmp_path / "dual_ur5e_9kg.csv").write_text("")
    with (tmp_path / "dual_ur5e_4.4kg.csv").open("a") as file:
        file.write("1,2,lost\n")
    runs = runs_of(tmp_path)
    said = capsys.readouterr().out
    assert [*runs] == [*FITTED, "dual_ur5e_3,4kg_again"]
    assert mass_of("dual_ur5e_3,4kg_again") == 3.4
    assert "dual_ur5e_1.4kg.csv is left out: expected columns force_R_z" in said
    assert "dual_ur5e_0.5kg.csv is left out: expected 10 samples" in said
    assert "dual_ur5e_9kg.csv is left out" in said
    assert "dual_ur5e_4.4kg.csv: 1 rows of 901 are not numbers" in said
    for name in runs:
        assert runs[name]["force_L_z"] == pytest.approx(run(mass_of(name), 3 if "3,4" in name else 0)["force_L_z"])
