# Everything runs in .venv, which is made on first use; `make PYTHON=/path/to/python3.11 venv` chooses another Python.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
JOBS ?= 2
# Many tests wait for processes that they have started.
WORKERS ?= $(shell expr $(JOBS) + 1)
COUNT ?= 3000
HOURS ?= 1
RUNS ?= 1000
SETS ?= $(wildcard ../shared/stereo)
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
DOCS_INSTALLED := $(VENV)/.docs-installed
# Kernels that check bounds lie by themselves, and are the same for all clones.
CHECKED := NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=$(or $(XDG_CACHE_HOME),$(HOME)/.cache)/dvc3d/checked-kernels

# Tests start hundreds of processes, each of which would compile every module that it imports.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help venv browser demo kernels test test-all test-nojit coverage test-bounds fuzz cuts canaries streams mutants check reproduce pictures format results results-check docs clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 14

venv: kernels  ## make the virtual environment in .venv, with compiled kernels

$(INSTALLED): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed: make PYTHON=...")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[all,test,check]'
	@touch $@

demo: kernels  ## render a moving camera, code it between two processes, show rates, quality and depth
	$(BIN)/python -m benchmarks.demo --out out/demo

browser: $(INSTALLED)  ## find a browser for the tests of the report page, or install one (tests do it)
	$(BIN)/python -m tests.browser

kernels: $(INSTALLED)  ## compile the kernels, or take them from where an earlier clone has kept them
	$(BIN)/python -m tests.kernels fetch
	$(BIN)/dvc-compile --jobs $(JOBS)

test: browser kernels  ## run the tests; what they compile is kept in the user's cache folder
	$(BIN)/python -m pytest -m "not slow" -n $(WORKERS) --dist worksteal
	$(BIN)/python -m tests.kernels keep

test-all: browser kernels  ## run the long studies too, and every frozen stream on every emulated processor
	DVC_ALL_PROCESSORS=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal

test-nojit: $(INSTALLED)  ## run the tests of the kernels as plain Python
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -m nojit

coverage: $(INSTALLED)  ## tell which lines of the packages tests run, kernels as plain Python (half an hour)
	rm -rf out/coverage
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'coverage>=7.10'
	$(BIN)/python -m coverage run -m pytest -m "not slow" -n $(JOBS) --dist worksteal
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m coverage run -m pytest -m nojit
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report
	$(BIN)/python -m pip uninstall --quiet --yes coverage  # numba would import it in every process

test-bounds: $(INSTALLED)  ## run kernels under bounds checks on frozen streams and COUNT mutations a kind (an hour)
	$(CHECKED) $(BIN)/python -m benchmarks.hostile.bounds
	$(CHECKED) $(BIN)/python -m pytest -q -n $(JOBS) -k to_the_frozen tests/test_golden.py tests/dibr/test_golden.py
	$(CHECKED) $(BIN)/python -m benchmarks.hostile --jobs $(JOBS) --count $(COUNT)

fuzz: $(INSTALLED)  ## try for HOURS what nobody has tried, under bounds checks, keep what does harm, and write down how much it was
	$(CHECKED) $(BIN)/python -m benchmarks.hostile --jobs $(JOBS) --hours $(HOURS) --finds tests/golden/finds

cuts: $(INSTALLED)  ## cut live runs at random moments until RUNS were tried in all; goes on where it ended
	$(BIN)/python -m benchmarks.hostile.cuts --runs $(RUNS)

canaries: $(INSTALLED)  ## store bytes and PSNR of small encodings anew, after a change of the encoder that is meant
	DVC_REGENERATE=1 $(BIN)/python -m pytest -q -k "as_before or cost_the_same" tests/test_canaries.py tests/dibr/test_golden.py

streams: $(INSTALLED)  ## freeze streams that are listed in tests and are not frozen yet
	$(BIN)/python -m tests.golden_streams
	DVC_REGENERATE=1 $(BIN)/python -m pytest -q -k frozen_pictures tests/dibr/test_golden.py

mutants: $(INSTALLED)  ## change the packages here and there, and list what no test notices (hours; goes on where it ended)
	$(BIN)/python -m benchmarks.mutants --jobs $(JOBS)

check: $(INSTALLED)  ## check format, lint, types, layers and spelling (docstrings are tested by make test)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/codespell

results: $(INSTALLED)  ## measure the headline results of docs/results.md that are not of this code (two hours)
	$(BIN)/python -m benchmarks.results --jobs $(JOBS)

docs: $(DOCS_INSTALLED)  ## build the documentation site in out/docs; its tutorials are executed
	$(BIN)/dvc-compile --jobs $(JOBS)
	$(BIN)/python -m sphinx -q -W --keep-going -c docs/site -b html docs out/docs

$(DOCS_INSTALLED): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[all,docs]'
	@touch $@

results-check: $(INSTALLED)  ## tell which results are those of this code
	$(BIN)/python -m benchmarks.results --check

reproduce: $(INSTALLED)  ## measure the tables and figures of the thesis, quickly, into results/thesis; SETS=DIR: real sets
	$(BIN)/python -m benchmarks.thesis --out results/thesis --jobs $(JOBS) $(if $(SETS),--data $(SETS))

pictures: $(INSTALLED)  ## draw the pictures of docs/ again, and those of real clips in results/
	$(BIN)/python -m benchmarks.pictures.first
	$(BIN)/python -m benchmarks.pictures.scene
	$(BIN)/python -m benchmarks.pictures.map
	$(BIN)/python -m benchmarks.pictures.stereo
	$(BIN)/python -m benchmarks.pictures.dibr

format: $(INSTALLED)  ## format the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:  ## remove what was built, but not .venv
	rm -rf out build dist .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -print | xargs rm -rf
