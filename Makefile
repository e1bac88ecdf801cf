# Each target sets the machine up first (tools/setup.sh, a moment when nothing is to do).
# Extra arguments: make quickstart ARGS="--out runs/mine", make test ARGS="-k poses".
.DEFAULT_GOAL := help
.PHONY: help setup quickstart test lint format bench check-format check-lint check-types

PYTHON := .venv/bin/python
# Workers, not threads, share the cores: one file of tests to a worker at a time.
PYTEST := OMP_NUM_THREADS=1 $(PYTHON) -m pytest -n 2 --dist loadfile
ARGS :=

help:  ## Show the targets.
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' Makefile

setup:  ## Install what is missing: system packages, .venv, Python packages.
	@tools/setup.sh

quickstart: setup  ## Run the whole chain, small: sample, demo, label, convert, train, eval.
	@.venv/bin/codediffuser quickstart $(ARGS)

test: setup  ## Run the tests.
	@$(PYTEST) $(ARGS)

lint: setup  ## Check format, lint and types, as pre-commit and CI do.
	@$(MAKE) --no-print-directory check-format check-lint check-types

format: setup  ## Format the code and mend what ruff can mend.
	@$(PYTHON) -m ruff format .
	@$(PYTHON) -m ruff check --fix .

bench: setup  ## Compare rendering speed with stock ManiSkill, interleaved in one run.
	@$(PYTHON) -m codediffuser.datagen.bench $(ARGS)

# What pre-commit calls too; no set-up, so that a commit stays quick.
check-format:
	@$(PYTHON) -m ruff format --check .
check-lint:
	@$(PYTHON) -m ruff check .
check-types:
	@$(PYTHON) -m mypy
	@$(PYTHON) -m mypy --allow-any-generics examples/*.py
