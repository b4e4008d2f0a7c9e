# Every target does its own set-up: it makes the virtual environment .venv from plain python3 and installs imufield there
# once, and again after pyproject.toml has changed. "make help" lists the targets.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORE := $(VENV)/.core
TEST := $(VENV)/.test
DEV := $(VENV)/.dev

.DEFAULT_GOAL := help
.PHONY: help demo test bench study fuzz lint style mypy pyright numerical docs torture coverage audit lock changelog wheel clean screens scripts

help:
	@echo "make demo    the whole chain on a virtual instrument, about a minute"
	@echo "make test    the tests"
	@echo "make bench   speed, memory and accuracy, measured"
	@echo "make study   the papers' tables and figures, and the answers, in full: some two hours of one core; writes docs/study.md, docs/answers.md"
	@echo "make fuzz    a minute of random and damaged bytes for every instrument"
	@echo "make lint    style, types"
	@echo "make numerical  the tests of numbers with the oldest kernels that the processor can run"
	@echo "make scripts  types of the page's scripts, by tools that npm installs; make test then looks for barriers, too"
	@echo "make docs    build the documentation into build/docs; broken links and examples fail"
	@echo "make torture  kills, cuts, bad wires and damaged files, in full, about 4 h on two cores; writes docs/reliability.md"
	@echo "make coverage  branches tested in acquire, calibrate and guide; below 90 % fails"
	@echo "make audit   compare the installed packages with the lock file; make lock writes that file anew"
	@echo "make changelog  what has changed since the last release"
	@echo "make screens draw the guide's screens, its page and the report in README and docs again, from emulated sessions"
	@echo "make wheel   build source archive and wheel into dist/, check what is in them"
	@echo "make clean   remove .venv and everything built"

demo: $(CORE)
	$(BIN)/imufield demo
	@echo
	@echo "imufield is installed as $(BIN)/imufield: run it so, or type \". $(BIN)/activate\" once in each terminal"
	@echo "and then imufield alone."

# Tests often wait for ports: with four at a time two cores are idle for a minute of six, a sixth slows the others down. A file
# stays in one process: the lines of a page, for example, build on each other. The order of files is that of tests/conftest.py.
# .ci/run takes three, as it does other work beside them. Compiled modules are kept, also where the environment says otherwise:
# each process would compile seven hundred anew.
WORKERS := 5
test: $(TEST)
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

bench: $(TEST)
	$(BIN)/python -m benchmarks

# Without --seed: the pages must be what "imufield study all" and "imufield study answers" give.
study: $(TEST)
	$(BIN)/imufield study all --document docs/study.md --output build/study
	$(BIN)/imufield study answers --document docs/answers.md --output build/study

fuzz: $(TEST)
	IMUFIELD_FUZZ_S=60 $(BIN)/python -m pytest -p no:xdist tests/acquire/test_fuzz_wires.py

# "make -j2 lint" keeps two cores busy.
lint: style mypy pyright

# What one finds does not hide what the other does.
style: $(DEV)
	status=0; $(BIN)/ruff check . || status=1; $(BIN)/ruff format --check . || status=1; exit $$status

mypy: $(DEV)
	$(BIN)/mypy imufield drivers tests benchmarks .ci/*.py

pyright: $(DEV)
	$(BIN)/pyright --pythonpath $(BIN)/python

numerical: $(TEST)
	$(BIN)/python .ci/numerical.py

# Nothing of what npm installs is shipped.
SCRIPTS := tests/web/scripts
scripts: $(SCRIPTS)/node_modules/.made
	$(SCRIPTS)/node_modules/.bin/tsc --project $(SCRIPTS)

$(SCRIPTS)/node_modules/.made: $(SCRIPTS)/package-lock.json
	npm ci --no-audit --no-fund --ignore-scripts --prefix $(SCRIPTS)
	@touch $@

# Not --quiet: mkdocs counts only the warnings that it prints.
docs: $(DEV)
	$(BIN)/python -m pytest tests/test_docs.py tests/test_docs_build.py tests/commands/test_docs_commands.py
	$(BIN)/python -m mkdocs build --strict

# Two at a time keep two cores busy; the claims take all cores by themselves. What was interrupted goes on where it stopped,
# and what fails keeps nothing else from being done. PART=link does one of them; claims is another.
TORTURE_PARTS := $(if $(PART),$(PART),killed cut faults link sequences files reproductions second_corpus web)
torture: $(TEST)
	status=0; export TORTURE=full; \
	$(if $(filter-out claims,$(TORTURE_PARTS)),$(BIN)/python -m pytest -n 2 --dist worksteal \
	  $(patsubst %,tests/torture/test_%.py,$(filter-out claims,$(TORTURE_PARTS))) || status=1;) \
	$(if $(filter claims,$(or $(PART),claims)),$(BIN)/python -m pytest tests/torture/test_claims.py tests/test_honesty.py || status=1;) \
	exit $$status

changelog: $(DEV)
	$(BIN)/python -m towncrier build --draft --version "not released yet"

audit: $(DEV)
	$(BIN)/python .ci/audit.py

lock: $(DEV)
	$(BIN)/python .ci/audit.py --write

coverage: $(DEV)
	$(BIN)/python -m coverage run -m pytest tests/acquire tests/calibrate tests/guide tests/drivers
	$(BIN)/python .ci/coverage_floor.py

screens: $(DEV)
	$(BIN)/python .ci/make_screens.py
	$(BIN)/python .ci/make_page_screens.py

# The source archive is built first and the wheel from it: what is not in the archive cannot get into the wheel.
wheel: $(DEV)
	rm -rf dist
	$(BIN)/python .ci/man_page.py imufield.1
	$(BIN)/python -m build $(BUILD) --outdir dist
	$(BIN)/python .ci/check_wheel.py dist/*.whl

clean:
	rm -rf $(VENV) build dist imufield.1 *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

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
