# Everything runs in .venv, which is made on first use; `make PYTHON=/path/to/python3.11 venv` chooses another Python.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
JOBS ?= 2
# Many tests wait for processes that they have started.
WORKERS ?= $(shell expr $(JOBS) + 1)
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
COMPILED := $(VENV)/.compiled
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# Rooms with quick tests, and of other rooms files with quick tests, so that each package has some.
QUICK := $(addprefix tests/,config entropy geometry images layers slepian_wolf stream tracks web wynerziv \
	decoder/side_information/test_kernels.py encoder/test_spacing.py sequences/test_kernels.py \
	sfm/test_decompositions.py test_no_feedback.py test_versions.py)

# Tests start hundreds of processes, each of which would compile every module that it imports.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help venv demo test test-quick test-all check docs results clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 14

venv: $(COMPILED)  ## make the virtual environment in .venv, and compile the kernels

$(INSTALLED): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed: make PYTHON=...")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) --upgrade 'pip>=25.1'  # the first that knows dependency groups
	$(PIP) --editable '.[all]' --group test --group check
	@touch $@

$(COMPILED): $(INSTALLED)
	$(BIN)/dvc-compile --jobs $(JOBS)
	@touch $@

demo: venv  ## render a moving camera, code it between two processes, show rates, quality and depth
	$(BIN)/python -m benchmarks.demo --out out/demo

test: venv  ## run the tests
	$(BIN)/python -m tests.browser
	$(BIN)/python -m pytest -m "not slow" -n $(WORKERS) --dist worksteal

test-quick: venv  ## run a quick part of the tests, of every package
	$(BIN)/python -m pytest -m "not slow" -n $(JOBS) --dist worksteal $(QUICK)

test-all: venv  ## run the long studies too, and every frozen stream on every emulated processor
	$(BIN)/python -m tests.browser
	DVC_ALL_PROCESSORS=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal

check: $(INSTALLED)  ## check format, lint, types, layers, spelling and phrases
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/codespell
	$(BIN)/python -m tests.english

docs: venv  ## build the documentation site in out/docs; its tutorials are executed
	$(PIP) --group docs
	$(BIN)/python -m sphinx -q -W --keep-going -c docs/site -b html docs out/docs

results: venv  ## measure the headline results of docs/results.md that are not of this code (two hours)
	$(BIN)/python -m benchmarks.results --jobs $(JOBS)

clean:  ## remove what was built, but not .venv
	rm -rf out build dist .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -print | xargs rm -rf
