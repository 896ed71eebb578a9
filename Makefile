# Everything runs in .venv, made when missing and kept while pyproject.toml and constraints.txt stay as they are.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
OUT ?= demo
PHOTO ?=
BENCH ?= out/bench
DATA ?=
QUICK ?= --quick
# each worker takes a half of the tests as they stand, so that what a module's tests share is made once; whoever is ready helps
# one thread each: beside another busy process two threads wait for each other at each convolution
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal

.PHONY: help demo docs test test-slow test-all test-lab lint bench firmware clean

help:
	@echo "make demo             the whole chain on a bundled photo, to $(OUT)/report.html"
	@echo "make demo PHOTO=path  the same on a blurred photo of your own"
	@echo "make docs             the site of the documentation, to docs/_build/html/index.html"
	@echo "make test             the quick tests of what is installed: cep, motdiff, hw"
	@echo "make test-slow        its slow tests: searches, trainings, notebooks, a browser"
	@echo "make test-all         both of them in one run"
	@echo "make test-lab         the tests of the laboratory, lab/"
	@echo "make lint             ruff, strict mypy and the rules on imports"
	@echo "make bench            the paper's tables at their quick size, to $(BENCH)/README.md"
	@echo "make bench QUICK= DATA=folder   the same at full size (days), of your photos; stopped, it goes on"
	@echo "make firmware         the shutter controller's firmware; MAX_ON_US=500 MAX_DUTY_PERMILLE=400 builds limits in"

demo: $(READY)
	$(BIN)/cep demo --force -o "$(OUT)" $(if $(PHOTO),--photo "$(PHOTO)")

docs: $(READY)
	$(BIN)/python -m pip install --disable-pip-version-check --quiet -c constraints.txt -e '.[docs]'
	$(BIN)/sphinx-build -q -W --keep-going -b html docs docs/_build/html

test: $(READY)
	$(PYTEST) -m "not slow"

test-slow: $(READY)
	$(PYTEST) -m slow

test-all: $(READY)
	$(PYTEST)

test-lab: $(READY)
	$(PYTEST) tests/lab lab

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

bench: $(READY)
	$(BIN)/python -m lab bench $(QUICK) --force -o "$(BENCH)" $(if $(DATA),--data "$(DATA)")

firmware:
	$(MAKE) -C hw/firmware/avr

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist *.egg-info
	rm -rf cep/__pycache__/compiled-*

# The stamp is touched last: an interrupted installation is finished by the next make.
$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11, 3.12 or 3.13 is needed, this is %d.%d: make PYTHON=python3.12 ..." % sys.version_info[:2] if not (3, 11) <= sys.version_info < (3, 14) else 0)'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check --quiet -c constraints.txt -e '.[dev]'
	touch $(READY)
