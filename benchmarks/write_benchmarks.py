"""Write what a benchmark run measured: the page, its figures, the README's table.

python -m benchmarks.bench --json > results/bench.json
python benchmarks/write_benchmarks.py results/bench.json
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks import bench_page, bench_plots

ROOT = Path(__file__).parents[1]


def main() -> None:
    """Write page, figures and table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("document", type=Path, help="what `python -m benchmarks.bench --json` printed")
    document = json.loads(parser.parse_args().document.read_text())
    (ROOT / "docs" / "benchmarks.md").write_text(bench_page.page(document))
    bench_plots.save(document, ROOT / "docs" / "images")
    readme = ROOT / "README.md"
    readme.write_text(bench_page.with_table(readme.read_text(), bench_page.readme(document)))
    print("wrote docs/benchmarks.md, docs/images/bench_*.png and the table in README.md")


if __name__ == "__main__":
    main()
