# holdfast: `make demo` and `make test` need only python3 (>= 3.11), its venv module and make.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
# Hundreds of processes import the library, which Python is to compile once.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo style test test-slow test-portable acceptance fuzz million lint stubs counts capabilities bench registers drift contacts distributions pictures robots docs clean

demo: $(VENV)/.demo
	$(BIN)/holdfast simulate examples/two_pandas.toml --out results/two_pandas --overwrite
	$(BIN)/holdfast view results/two_pandas --export results/two_pandas.html --overwrite
	@echo "see the arms move: open $(CURDIR)/results/two_pandas.html in a browser, for example by"
	@echo "$(BIN)/python -m webbrowser 'file://$(CURDIR)/results/two_pandas.html'"

# Machine code for tests is compiled quickly: the same bits, in half the time. The other targets compile it in full.
# Types are checked meanwhile, which takes one processor the better part of a minute.
test: style
	@$(BIN)/pyright & types=$$!; \
	HOLDFAST_COMPILE=quick $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow and not long"; tests=$$?; \
	wait $$types && exit $$tests

# Tests of seconds each: whole examples, their types by mypy, pages of the documentation, further chains and schemes (half an hour, or an hour on slow processors).
test-slow: $(VENV)/.dev
	HOLDFAST_COMPILE=quick $(BIN)/python -m pytest -n 2 --dist worksteal -m "slow and not long"

# The tests under other processors' BLAS kernels, machine code for each level of x86-64 and for 64-bit ARM (some 21 minutes).
# The last needs QEMU: apt-get install qemu-user gcc-aarch64-linux-gnu libc6-dev-arm64-cross
test-portable: $(VENV)/.dev
	$(BIN)/python -m tests.portable

# The issue's full-size checks: thousands of random systems, multiprecision sweeps.
acceptance: $(VENV)/.dev
	$(BIN)/python -m pytest -m long -n 2 --dist worksteal -rP --timeout 3600

# Wrong arguments for every public call (CASES=100000 SEED=3000 for more and others).
CASES ?= 3000
SEED ?= 0
fuzz: $(VENV)/.dev
	HOLDFAST_COMPILE=quick $(BIN)/python -m tests.fuzz $(CASES) $(SEED)

# A million runs by two workers of Dask beside bare rollouts (RUNS=100000 for fewer; leave the machine alone meanwhile).
RUNS ?= 1000000
million: $(VENV)/.dev
	$(BIN)/python benchmarks/sweep_million.py $(RUNS)

# Random questions about forces, beside Clarabel (QUESTIONS=2000 for fewer).
QUESTIONS ?= 10000
distributions: $(VENV)/.dev
	$(BIN)/python -m benchmarks.random_distributions --count $(QUESTIONS)

style: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

lint: style
	$(BIN)/pyright

# The stub of compiled chains and the page of all questions, made of their declarations.
stubs: $(VENV)/.dev
	$(BIN)/python benchmarks/write_stubs.py

# Operation counts of every algorithm, into docs/operation_counts.md.
counts: $(VENV)/.dev
	$(BIN)/python benchmarks/operation_counts.py --write docs/operation_counts.md

# Every kind of chain against every question, into docs/coverage.md (minutes).
capabilities: $(VENV)/.dev
	HOLDFAST_COMPILE=quick $(BIN)/python -m tests.capabilities.page --write docs/coverage.md

# Speed against other libraries, into docs/benchmarks.md and the README, and the cost of a step of `simulate` into
# docs/limitations.md; then the same beside its bars and MuJoCo, printed (minutes; leave the machine alone meanwhile).
bench: $(VENV)/.bench
	mkdir -p results
	$(BIN)/python -m benchmarks.bench --json > results/bench.json
	HOLDFAST_CPU=x86-64-v3 $(BIN)/python -m benchmarks.bench --json > results/bench_avx2.json
	$(BIN)/python benchmarks/bench_page.py results/bench.json --avx2 results/bench_avx2.json
	$(BIN)/python benchmarks/registers.py --write docs/benchmarks.md
	$(BIN)/python benchmarks/simulation_cost.py --write docs/limitations.md
	$(BIN)/python benchmarks/simulate_speed.py

# Use of registers and memory by the machine code, counted and timed, into docs/benchmarks.md (some two minutes).
registers: $(VENV)/.dev
	$(BIN)/python benchmarks/registers.py --write docs/benchmarks.md

# Closure error against time, beside Pinocchio and MuJoCo, into docs/drift.md (minutes).
drift: $(VENV)/.bench
	$(BIN)/python benchmarks/drift_figure.py

# Contacts beside MuJoCo and, if it is installed, Drake, into docs/how_to/contact.md (minutes).
contacts: $(VENV)/.bench
	$(BIN)/python benchmarks/contact_figure.py --write docs/how_to/contact.md

# Real robots for the long checks, from wheels on PyPI (some 600 MB pass through; URDF files stay, and MJCF files with their meshes).
robots: $(VENV)/.dev
	$(BIN)/python -m tests.robots.fetch_real_robots results/robots

# The README's picture, from the demo; needs chromium.
pictures: demo $(VENV)/.dev
	cp results/two_pandas/grasp_wrenches.png docs/images/
	$(BIN)/python benchmarks/joint_path_figure.py
	$(BIN)/python benchmarks/controller_pictures.py
	$(BIN)/python -m benchmarks.timed_paths --picture
	HOLDFAST_RESULT=results/two_pandas HOLDFAST_PICTURE=docs/images/viewer.png $(BIN)/python -m pytest -q tests/view/test_page_in_chromium.py -k readme_picture

# The documentation site, into docs/_build/html; without network, without warnings.
docs: $(VENV)/.docs
	$(BIN)/sphinx-build -W --keep-going -q -b html docs docs/_build/html

$(VENV)/.docs: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --editable ".[docs]"
	touch $@

$(VENV)/.demo: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --editable ".[plot,view]"
	touch $@

$(VENV)/.dev: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --editable ".[plot,view,dev]"
	touch $@ $(VENV)/.demo

$(VENV)/.bench: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --editable ".[bench]"
	touch $@

clean:
	rm -rf $(VENV) results
