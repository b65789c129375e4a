SHELL := /bin/sh
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

PYTHON_ENV := .venv/bin/python
ENVIRONMENT := .venv/.installed
PYTEST_ARGS ?=
PYTEST := OMP_NUM_THREADS=1 $(PYTHON_ENV) -m pytest -n 2 --dist loadfile --no-loadscope-reorder
DEMO_ARGS ?=
RESULTS_ARGS ?=

# Python may cache what it compiles: importing everything anew takes 14 s a process.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help setup demo test test-fast coverage documents docs ray check format type build benchmark results lock clean

help: ## List the targets (the default)
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  make \1 # \2/p' $(MAKEFILE_LIST) | awk -F' # ' '{ printf "%-18s %s\n", $$1, $$2 }'

setup: $(ENVIRONMENT) ## Install everything into .venv, once (PYTHON=... picks the interpreter)

$(ENVIRONMENT): requirements.lock pyproject.toml envs/pyproject.toml policies/pyproject.toml robots/pyproject.toml scripts/environment
	@scripts/environment .venv --editable . --editable envs --editable policies --editable robots
	@touch $@

demo: setup ## Move a skill between two robots and show it: outputs/demo/report.html
	@$(PYTHON_ENV) -m cei_converters.start demo $(DEMO_ARGS)

test: setup ## Run the tests (PYTEST_ARGS="-k word" picks some)
	@$(PYTEST) $(PYTEST_ARGS) tests

test-fast: setup ## Run the tests of all files that take seconds, in less than two minutes
	@$(PYTEST) --fast $(PYTEST_ARGS) tests

coverage: setup ## Run the tests and show which lines they reach: a table, and htmlcov/index.html
	@$(PYTEST) --cov --cov-report=term --cov-report=html $(PYTEST_ARGS) tests

documents: setup ## Run every command and piece of code of the documents, made small (DOCUMENTS=docs/policies.md picks some)
	@$(PYTHON_ENV) -P tests/smoke/documents.py . $(DOCUMENTS)

docs: setup ## Build the documentation site into outputs/site; broken links and undocumented public names fail
	@NO_MKDOCS_2_WARNING=1 $(PYTHON_ENV) -m mkdocs build --strict

ray: setup ## Test conversions on a Ray cluster of this machine
	@CEI_RAY=1 $(PYTHON_ENV) -m pytest -k ray tests/test_resume.py

check: setup ## Check format, lint and types; changes nothing
	@.venv/bin/ruff format --check --quiet .
	@.venv/bin/ruff check --quiet .
	@$(MAKE) --no-print-directory type

format: setup ## Format the code and fix what the linter can
	@.venv/bin/ruff check --fix --quiet . || true
	@.venv/bin/ruff format .

type: setup ## Check types
	@.venv/bin/pyright

build: setup ## Build the wheels and sdists of all distributions into dist/
	@rm -rf dist
	@$(PYTHON_ENV) -m build --quiet --no-isolation --outdir dist .
	@$(PYTHON_ENV) -m build --quiet --no-isolation --outdir dist envs
	@$(PYTHON_ENV) -m build --quiet --no-isolation --outdir dist policies
	@$(PYTHON_ENV) -m build --quiet --no-isolation --outdir dist robots
	@ls dist/*

benchmark: setup ## Run every benchmark (hours, and 40 GB of disk)
	@$(PYTHON_ENV) -m cei_converters.benchmark.command replay
	@for file in benchmarks/*.py; do echo "== $$file"; $(PYTHON_ENV) "$$file" || exit; done

results: setup ## List figures that are older than the code they measure (RESULTS_ARGS=--mark marks them in documents)
	@$(PYTHON_ENV) -m cei_converters.benchmark.command results $(RESULTS_ARGS)

lock: ## Bring requirements.lock up to the pyprojects (LOCK_ARGS=--upgrade for newer versions)
	@scripts/lock $(LOCK_ARGS)

clean: ## Remove what the other targets made, but not .venv
	@rm -rf build dist outputs .pytest_cache .ruff_cache .hypothesis .coverage* htmlcov
	@find . -name __pycache__ -type d -not -path './.venv/*' -prune -exec rm -rf {} +
