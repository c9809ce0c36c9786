# The virtual environment that these commands need is made by themselves, once.
#   make reproduce   the paper, end to end, to build/report/report.html
#   make test        linters, layers, types, and the tests of everything that a change can break
#   make verify      the same with all tests: statistical, exhaustive and long ones too
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
OUT    ?= build/report
# Up to four processes for tests: one for each core, and for each 3 GB of memory.
WORKERS ?= $(shell $(PYTHON) -c 'import os; cores = len(getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count()))(0)); \
  print(max(min(4, cores, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 3_000_000_000), 1))')
COUNT  ?= 27
SEED   ?= 0
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# A core each, and bytecode for the processes that tests start. A worker that dies is not replaced; otherwise a test that
# hangs would be repeated until all are dead.
PYTEST := env -u PYTHONDONTWRITEBYTECODE OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder --max-worker-restart 0

.PHONY: reproduce test verify lint style types quick-tests all-tests format hooks mutants lock bench docs course wheel clean help
.DEFAULT_GOAL := help

help:
	@sed -n 's/^#   //p' Makefile

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "mckibben needs Python 3.11 or newer; try: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable .
	@touch $@

$(VENV)/.installed-%: pyproject.toml | $(BIN)/python
	$(INSTALL) 'pip>=25.1'  # an older one knows no groups
	$(INSTALL) --editable . --group $*
	@touch $(VENV)/.installed $@

reproduce: $(VENV)/.installed
	$(BIN)/mckibben reproduce --out $(OUT)

lint: style types

style: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache

types: $(VENV)/.installed-dev
	$(BIN)/pyrefly check

quick-tests: $(VENV)/.installed-dev
	$(PYTEST) -m "not slow"

all-tests: $(VENV)/.installed-dev
	$(PYTEST)

test: lint quick-tests

verify: lint all-tests

#   make format      put the code in its house style
format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

#   make hooks       check each commit and push with the tools of make test
hooks: $(VENV)/.installed-dev
	$(BIN)/pre-commit install --hook-type pre-commit --hook-type pre-push

#   make mutants     small random faults in a copy of the source, and which of them no test notices (COUNT=27 SEED=0)
mutants: $(VENV)/.installed-dev
	$(BIN)/python benchmarks/mutants.py --count $(COUNT) --seed $(SEED)

#   make lock        write the versions of this environment to requirements-dev.lock
lock: $(VENV)/.installed-dev
	$(BIN)/python -m pip freeze --disable-pip-version-check --exclude-editable > requirements-dev.lock

#   make bench       ratios against plain C and others, measured in one run, to build/benchmarks.md
bench: $(VENV)/.installed-dev $(VENV)/.installed-bench
	$(BIN)/python benchmarks/run.py --markdown build/benchmarks.md

#   make docs        the documentation as a site with executed examples, to build/docs/index.html
docs: $(VENV)/.installed-docs
	rm -rf build/docs build/doctrees docs/api docs/gallery  # or examples would keep the output of an older program
	$(BIN)/python -m sphinx -b html -W --keep-going -j $(WORKERS) -d build/doctrees docs build/docs
	$(BIN)/python docs/check_site.py build/docs

#   make course      notebooks of teachers and students, in build/course
course: $(VENV)/.installed-dev
	rm -rf build/course
	$(BIN)/python course/notebooks.py build/course

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
