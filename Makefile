# Two commands do everything on a machine with Python 3.10 or newer: `make quickstart` and `make test`.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin

.PHONY: install quickstart check test clean

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet -e '.[dev]' -c constraints.txt
	touch $@

quickstart: install
	$(BIN)/prt table quickstart

check: install
	$(BIN)/ruff check prt tests
	$(BIN)/ruff format --check prt tests
	$(BIN)/pyright

test: check
	$(BIN)/pytest

clean:
	rm -rf $(VENV) runs
