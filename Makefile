# `make reproduce` sets up and runs the default scale to all tables. `make check` runs linters, types
# and the quick tests; `make test` checks everything.
.PHONY: reproduce check test lint setup clean

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
PYTEST := $(BIN)/pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

reproduce: $(READY)
	$(BIN)/snakemake

check: lint
	$(PYTEST) -m "not slow"

test: lint
	$(PYTEST)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/snakemake --lint
	$(BIN)/mypy

setup: $(READY)

# A new environment only where what it holds has changed.
$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv --clear .venv
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $(READY)

clean:
	rm -rf .venv
