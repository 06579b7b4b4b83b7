# `make reproduce` sets up and runs the default scale to all tables; `make test` checks everything.
.PHONY: reproduce test setup clean

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

reproduce: $(READY)
	$(BIN)/snakemake

test: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/snakemake --lint
	$(BIN)/pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

setup: $(READY)

# A new environment only where what it holds has changed.
$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv --clear .venv
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $(READY)

clean:
	rm -rf .venv
