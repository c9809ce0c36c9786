# Two commands do everything; the virtual environment they need is made by themselves, once.
#   make reproduce   the paper, end to end, to build/report/report.html
#   make test        lint, layers, types, doctests and tests
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
OUT    ?= build/report
WORKERS ?= 2

.PHONY: reproduce test lint style types tests format bench docs wheel clean help
.DEFAULT_GOAL := help

help:
	@sed -n 's/^#   //p' Makefile

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "mckibben needs Python 3.11 or newer; try: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $(VENV)/.installed $@

$(VENV)/.installed-bench: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev,bench]'
	@touch $(VENV)/.installed $(VENV)/.installed-dev $@

$(VENV)/.installed-docs: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $(VENV)/.installed $@

reproduce: $(VENV)/.installed
	$(BIN)/mckibben reproduce --out $(OUT)

lint: style types

style: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache

types: $(VENV)/.installed-dev
	$(BIN)/pyright

tests: $(VENV)/.installed-dev
	$(BIN)/pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

test: style
	@$(MAKE) --no-print-directory --jobs 2 types tests  # the checker of types leaves all cores but one idle

#   make format      put the code in its house style
format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

#   make bench       ratios against plain C and others, measured in one run, to build/benchmarks.md and .json
bench: $(VENV)/.installed-bench
	@mkdir -p build
	$(BIN)/python benchmarks/run.py --json build/benchmarks.json --markdown build/benchmarks.md

#   make docs        the documentation as a site with executed examples, to build/docs/index.html
docs: $(VENV)/.installed-docs
	rm -rf build/docs build/doctrees docs/api docs/gallery  # or examples would keep the output of an older program
	$(BIN)/python -m sphinx -b html -W --keep-going -j $(WORKERS) -d build/doctrees docs build/docs
	$(BIN)/python docs/check_site.py build/docs

#   make wheel       source archive and wheel in dist, the wheel tried with all extras in a bare environment
wheel: $(VENV)/.installed-dev
	rm -rf dist build/bare build/bare-report
	$(BIN)/python -m build --no-isolation
	$(PYTHON) -m venv build/bare
	build/bare/bin/python -m pip install --quiet --disable-pip-version-check "$$(ls dist/*.whl)[all]"
	cd build && bare/bin/mckibben reproduce --quick --out bare-report

#   make clean       remove what these commands made
clean:
	rm -rf $(VENV) build dist docs/api docs/gallery .pytest_cache .ruff_cache
