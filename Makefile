# Everything a newcomer types. Needs Linux x86-64, Python 3.10 to 3.13 with venv, and make; nothing else.

SUITABLE := import ensurepip, sys, venv; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))
# The machine's own python3 where it will do, else the newest that will.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python3.10; do \
	$$p -c '$(SUITABLE)' 2>/dev/null && echo $$p && break; done)
REQUIREMENTS ?= -r requirements-dev.txt
CONSTRAINTS ?= -c constraints.txt
BIN := .venv/bin
PACKAGES := evalkit simgen posenet
STAMP := .venv/.installed

.PHONY: help demo test test-all lint bench docs install wheels version clean
.DEFAULT_GOAL := help

help: ## list these targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 12

install: $(STAMP) ## make .venv and install the three packages into it

$(STAMP): $(PACKAGES:%=packages/%/pyproject.toml) requirements-dev.txt constraints.txt
	@test -n "$(PYTHON)" || { echo "Error: Python 3.10 to 3.13 with venv is needed: install one (on Debian and Ubuntu: apt install python3-venv) and run 'make PYTHON=/path/to/python3'." >&2; exit 2; }
	@$(PYTHON) -c '$(SUITABLE)' || { echo "Error: $(PYTHON) is not Python 3.10 to 3.13 with venv, which the physics engine has wheels for: run 'make PYTHON=/path/to/python3'." >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet $(CONSTRAINTS) $(PACKAGES:%=-e packages/%) $(REQUIREMENTS)
	@touch $@

demo: $(STAMP) ## bunny mesh -> piles -> training -> poses -> AP and pictures, about a quarter of an hour
	$(BIN)/python benchmarks/demo.py

# A process a core, of one thread each (more would wait for each other); four at most, for each takes 2 GB.
PYTEST := OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile \
	--no-loadscope-reorder --max-worker-restart 0

test: $(STAMP) ## the tests, in some ten minutes on two cores
	$(PYTEST) -m "not slow"

test-all: $(STAMP) ## the thorough rest as well
	$(PYTEST)

lint: $(STAMP) ## ruff and mypy
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: $(STAMP) ## every figure that README states
	for script in benchmarks/speed/bench_*.py; do $(BIN)/python $$script || exit 1; done

docs: $(STAMP) ## the documentation as a site in site/, every link checked
	$(BIN)/python docs/scripts/error_catalogue.py docs/errors.md
	$(BIN)/python docs/scripts/command_reference.py docs/commands.md
	$(BIN)/python docs/scripts/api_pages.py docs/api
	PYTHONPATH=docs/scripts $(BIN)/python -m zensical build --strict --clean

wheels: $(STAMP) ## the three packages as wheels in dist/
	rm -rf dist $(PACKAGES:%=packages/%/build)
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist $(PACKAGES:%=./packages/%)
	@ls dist

version: ## write the version in VERSION wherever it is stated
	python3 tools/version.py

clean: ## remove what the demo, the documentation and the wheels made
	rm -rf demo site docs/errors.md docs/commands.md docs/api dist
