# Run `make` to see what there is.
SHELL := /bin/bash
PYTHON ?= python3
VENV ?= $(CURDIR)/.venv
export PYTHON VENV
# Programs and tests read thousands of modules, which takes twice as long from their sources.
unexport PYTHONDONTWRITEBYTECODE

IN_ENV = source tools/env.sh &&
TEST_ARGS ?=
DEMO_ARGS ?=

.PHONY: help setup setup-extras setup-test setup-docs setup-bench demo test test-fast fuzz reference lint format types docs bench clean

help: ## show this list
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

setup: ## set up the environment and build the workspace
	@tools/setup.sh

setup-extras: ## install what single commands need, such as campaign, tune, identify, falsify
	@tools/setup.sh extras

setup-test:
	@tools/setup.sh test

setup-docs: setup-test
	@tools/setup.sh docs

setup-bench:
	@tools/setup.sh bench

demo: setup ## design gains, run the graph on a 20 s scenario, record, report
	@$(IN_ENV) lpv demo $(DEMO_ARGS)

# One process more than cores, as many tests wait; files in the order of testpaths, where long ones
# come first. A graph that must keep up with the wall clock needs the machine for itself.
PARALLEL := -n $(shell expr $$(nproc) + 1) --dist loadfile --no-loadscope-reorder
# Tests without nodes never wait; a process that has nothing left to do takes over from another.
FAST := -n $(shell nproc) --dist worksteal
# Processes that share the machine must not each start a thread a core.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

# Both phases run, whatever the first one finds; the last line sums up.
test: setup-test ## run all tests, or those that TEST_ARGS selects
ifeq ($(TEST_ARGS),)
	@$(IN_ENV) export $(ONE_THREAD); \
	python -m pytest $(PARALLEL) -m "not realtime"; together=$$?; \
	python -m pytest -m realtime; realtime=$$?; \
	said() { [ $$1 = 0 ] && echo passed || echo "FAILED (pytest ended with $$1)"; }; \
	echo "make test: tests side by side $$(said $$together), in real time $$(said $$realtime)"; \
	[ $$together = 0 ] && [ $$realtime = 0 ]
else
	@$(IN_ENV) python -m pytest $(TEST_ARGS)
endif

test-fast: setup-test ## run the tests that need neither nodes nor long runs
	@$(IN_ENV) $(ONE_THREAD) python -m pytest $(FAST) -m "not slow and not ros" $(TEST_ARGS)

fuzz: setup-test ## run the fuzzers, LPV_FUZZ_SECONDS (default 60) each
	@$(IN_ENV) LPV_FUZZ_SECONDS=$${LPV_FUZZ_SECONDS:-60} python -m pytest -m fuzz --timeout=0 $(TEST_ARGS)

reference: setup-test ## store what the diagnosis answers now as what it shall answer
	@$(IN_ENV) python tests/support/reference.py

lint: setup-test ## check style and format
	@$(IN_ENV) ruff check . && ruff format --check .

format: setup-test ## apply the formatter
	@$(IN_ENV) ruff check --fix --select I -q . && ruff format .

types: setup-test ## check types
	@$(IN_ENV) MYPY_NUM_WORKERS=$$(nproc) mypy

docs: setup-docs ## build the documentation as a site in docs/_build
	@$(IN_ENV) python -m sphinx -q -W --keep-going -b html docs docs/_build

bench: setup-bench ## run the benchmarks
	@$(IN_ENV) for b in benchmarks/[!kl]*.py; do echo "== $$b"; python "$$b" || exit 1; done

clean: ## remove environment, build and results
	rm -rf "$(VENV)" .build out
