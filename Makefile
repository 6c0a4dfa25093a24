# Everything a newcomer types. Needs Linux x86-64, Python 3.10 or 3.11 with venv, and make; nothing else.

PYTHON ?= $(shell for p in python3.11 python3.10 python3; do \
	$$p -c 'import sys, venv; sys.exit(sys.version_info[:2] not in ((3, 10), (3, 11)))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
PACKAGES := evalkit simgen posenet
STAMP := .venv/.installed

.PHONY: help demo test test-all lint bench docs install clean
.DEFAULT_GOAL := help

help: ## list these targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 12

install: $(STAMP) ## make .venv and install the three packages into it

$(STAMP): $(PACKAGES:%=packages/%/pyproject.toml) requirements-dev.txt
	@test -n "$(PYTHON)" || { echo "Error: Python 3.10 or 3.11 with venv is needed (PyBullet has no wheels for later versions): install one and run 'make PYTHON=/path/to/python3.11'." >&2; exit 2; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 10), (3, 11)))' || { echo "Error: $(PYTHON) is not Python 3.10 or 3.11, the versions that PyBullet has wheels for: run 'make PYTHON=/path/to/python3.11'." >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet $(PACKAGES:%=-e packages/%) -r requirements-dev.txt
	@touch $@

demo: $(STAMP) ## bunny mesh -> piles -> training -> poses -> AP and pictures, about a quarter of an hour
	$(BIN)/python benchmarks/demo.py

test: $(STAMP) ## the tests, in less than a quarter of an hour
	$(BIN)/python -m pytest -m "not slow"

test-all: $(STAMP) ## the thorough rest as well
	$(BIN)/python -m pytest

lint: $(STAMP) ## ruff and mypy
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: $(STAMP) ## every figure that README states
	for script in benchmarks/bench_*.py; do $(BIN)/python $$script || exit 1; done

docs: $(STAMP) ## the documentation as a site in site/, every link checked
	$(BIN)/python docs/scripts/error_catalogue.py docs/errors.md
	$(BIN)/python docs/scripts/command_reference.py docs/commands.md
	PYTHONPATH=docs/scripts $(BIN)/python -m zensical build --strict --clean

clean: ## remove what the demo and the documentation made
	rm -rf demo site docs/errors.md docs/commands.md
