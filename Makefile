# Everything installs into $(VENV), once; after a change of pyproject.toml or constraints.txt, again.
PYTHON ?= python3
VENV ?= .venv
WORKERS ?= auto

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: help venv demo deploy-demo test test-slow test-all coverage lint docs clean

help:
	@echo "make demo    train a small team, evaluate it, record a playback (a few minutes)"
	@echo "make deploy-demo  eight robots, each a process of its own, live in the viewer (three minutes)"
	@echo "make test    run the tests"
	@echo "make test-slow  the tests that take long"
	@echo "make test-all   both"
	@echo "make coverage   the tests, and which lines they do not reach"
	@echo "make lint    ruff, mypy, import-linter"
	@echo "make docs    the site of docs/, into site/; a warning is an error"
	@echo "make venv    only set up $(VENV)"
	@echo "make clean   remove $(VENV) and what the tools left"

venv: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit("robosim needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	@echo "setting up $(VENV); the first time this takes some minutes"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--constraint constraints.txt --editable '.[test,dev]'
	@touch $@

demo: $(STAMP)
	@$(BIN)/robosim demo

# Without a display only the recording is written.
deploy-demo: $(STAMP)
	@$(BIN)/robosim deploy demo

test: $(STAMP)
	@$(BIN)/python -m pytest --quiet -n $(WORKERS)

# What takes long, or needs what the test environment lacks, such as Ray.
test-slow: $(STAMP)
	@$(BIN)/python -m pytest --quiet -n $(WORKERS) -m slow

test-all: $(STAMP)
	@$(BIN)/python -m pytest --quiet -n $(WORKERS) -m "slow or not slow"

coverage: $(STAMP)
	@$(BIN)/python -m pytest --quiet -n $(WORKERS) --cov

lint: $(STAMP)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy robosim tools examples
	@$(BIN)/lint-imports

docs: $(VENV)/.docs-installed
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "site/index.html; with the search: $(BIN)/python -m http.server --bind 127.0.0.1 --directory site"

$(VENV)/.docs-installed: $(STAMP)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--constraint constraints.txt --editable '.[docs]'
	@touch $@

clean:
	rm -rf $(VENV) build dist site .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis .coverage*
