# Run `make` to see what there is.
SHELL := /bin/bash
PYTHON ?= python3
VENV ?= $(CURDIR)/.venv
export PYTHON VENV

IN_ENV = source tools/env.sh &&
TEST_ARGS ?=
DEMO_ARGS ?=

.PHONY: help setup setup-test setup-bench demo test reference lint bench clean

help: ## show this list
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

setup: ## set up the environment and build the workspace
	@tools/setup.sh

setup-test:
	@tools/setup.sh test

setup-bench:
	@tools/setup.sh bench

demo: setup ## design gains, run the graph on a 20 s scenario, record, report
	@$(IN_ENV) lpv demo $(DEMO_ARGS)

test: setup-test ## run all tests
	@$(IN_ENV) python -m pytest $(TEST_ARGS)

reference: setup-test ## store what the diagnosis answers now as what it shall answer
	@$(IN_ENV) python tests/support/reference.py

lint: setup-test ## check style
	@$(IN_ENV) ruff check .

bench: setup-bench ## run the benchmarks
	@$(IN_ENV) for b in benchmarks/[!kl]*.py; do echo "== $$b"; python "$$b" || exit 1; done

clean: ## remove environment, build and results
	rm -rf "$(VENV)" .build out
