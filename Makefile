# Every target does its own set-up: it makes the virtual environment .venv from plain python3 and installs imufield there
# once, and again after pyproject.toml has changed. "make help" lists the targets.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORE := $(VENV)/.core
TEST := $(VENV)/.test
DEV := $(VENV)/.dev

.DEFAULT_GOAL := help
.PHONY: help demo test bench study lint docs wheel clean

help:
	@echo "make demo    the whole chain on a virtual instrument, about a minute"
	@echo "make test    the tests"
	@echo "make bench   speed, memory and accuracy, measured"
	@echo "make study   the papers' tables and figures in full, minutes on all cores; writes docs/study.md"
	@echo "make lint    style, types"
	@echo "make docs    check the documentation: links, examples, lists of errors and keys"
	@echo "make wheel   build source archive and wheel into dist/, check what is in them"
	@echo "make clean   remove .venv and everything built"

demo: $(CORE)
	$(BIN)/imufield demo

test: $(TEST)
	$(BIN)/python -m pytest

bench: $(TEST)
	$(BIN)/python -m benchmarks

# Without --seed: the page must be what "imufield study all" gives.
study: $(TEST)
	$(BIN)/imufield study all --document docs/study.md --output build/study

lint: $(DEV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy imufield drivers tests
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(TEST)
	$(BIN)/python -m pytest tests/test_docs.py

# The source archive is built first and the wheel from it: what is not in the archive cannot get into the wheel.
wheel: $(DEV)
	rm -rf dist
	$(BIN)/python -m build --outdir dist
	$(BIN)/python .ci/check_wheel.py dist/*.whl

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

$(VENV)/.made:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "imufield needs Python 3.11 or newer, but $(PYTHON) is: $$($(PYTHON) --version 2>&1)." >&2; \
	  echo "Install a newer one and name it, for example: make $(firstword $(MAKECMDGOALS) demo) PYTHON=python3.12" >&2; \
	  exit 1; }
	@echo "Making $(VENV) and installing imufield there; this happens once and takes a minute or two."
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(CORE): pyproject.toml | $(VENV)/.made
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(TEST): pyproject.toml | $(VENV)/.made
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	@touch $(CORE) $@

$(DEV): pyproject.toml | $(VENV)/.made
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $(CORE) $(TEST) $@
