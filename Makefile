# errpipe: `make` lists what there is to make. Needs Python 3.11 or newer, make, and a C compiler.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SETUP := $(VENV)/.set-up
PYTEST := $(BIN)/python -m pytest
SEED ?= 7
FROM ?= ../shared/real-data
CODE := errpipe tests trials bench examples
# One thread for linear algebra: results must not depend on how many cores a machine has.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Where it is set, every start compiles errpipe anew: a third of the time of a short command.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: $(shell sed -n 's/^\([a-z-]*\):.*\#\# .*/\1/p' Makefile)
.DEFAULT_GOAL := help

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-14s %s\n", $$1, $$2}' Makefile

setup: $(SETUP) ## make .venv with errpipe and its development extras

$(SETUP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo 'Python 3.11 or newer is needed: make PYTHON=python3.12 setup' >&2; exit 1; }
	@test -x $(BIN)/python || { echo 'making $(VENV)'; $(PYTHON) -m venv $(VENV); }
	@echo 'installing errpipe and its development extras into $(VENV)'
	@$(BIN)/python -m pip install -qq --disable-pip-version-check $(if $(CONSTRAINTS),-c $(CONSTRAINTS)) --editable '.[dev]'
	@touch $(SETUP)

demo: $(SETUP) ## run the main job on a simulated machine
	@$(BIN)/errpipe demo

test: $(SETUP) ## the fast tests
	@$(PYTEST) -m 'not slow' $(or $(ARGS),-n 2 --dist worksteal)

test-slow: $(SETUP) ## only the slow tests
	@$(PYTEST) -m slow $(ARGS)

test-all: $(SETUP) ## all tests
	@$(PYTEST) $(ARGS)

lint: $(SETUP) ## style and layout
	@$(BIN)/ruff check $(CODE)
	@$(BIN)/ruff format --check -q $(CODE)

types: $(SETUP) ## static types
	@$(BIN)/mypy errpipe

check: lint types test ## what to run before a change is offered
	@$(BIN)/errpipe check --no-data pipelines/*.yaml

generated: $(SETUP) ## write schemas/, reference pages, error texts and the README's counts again from the code
	@$(BIN)/errpipe schema --write schemas
	@$(BIN)/errpipe reference --write docs
	@WRITE_EXPECTED=1 $(PYTEST) tests/errors tests/contract/test_readme_counts.py

screenshots: $(SETUP) ## docs/pictures again, by headless chromium
	@$(BIN)/python -m tests.screenshots docs/pictures

bench: $(SETUP) ## speed, as ratios to other libraries in the same run
	@$(BIN)/python -m bench $(ARGS)

faults: $(SETUP) ## ten thousand random sequences of faults through every evaluator of a table (docs/safety.md)
	@$(BIN)/python -m tests.faults.campaign $(ARGS)

trials: $(SETUP) ## diagnosis on machines whose faults are known
	@mkdir -p out
	@$(BIN)/python -m trials.run --seed $(SEED) --jobs 2 --markdown out/trials.md --json out/trials.json $(ARGS)

trials-scales: $(SETUP) ## diagnosis of one textbook effect on machines of every scale
	@$(BIN)/python -m trials.scales --seed $(SEED) --jobs 2 $(ARGS)

trials-real: $(SETUP) ## diagnosis on real recordings whose repetition stands in for the simulation (FROM=folders)
	@$(BIN)/python -m trials.real --from $(FROM) --seed $(SEED) --jobs 2 $(ARGS)

trials-thermal: $(SETUP) ## thermal model families on simulated machines, judged by a season they have not seen
	@$(BIN)/python -m trials.thermal --seed $(SEED) $(ARGS)

trials-volumetric: $(SETUP) ## every measuring protocol on simulated machines: is anything exported worse than nothing?
	@$(BIN)/python -m trials.volumetric $(ARGS)

trials-faults: $(SETUP) ## sensors and controllers that fail in use: is a table then worse than nothing?
	@$(BIN)/python -m trials.faults_in_use --seed $(SEED) $(ARGS)

trials-examples: $(SETUP) ## the examples on machines drawn by seed: is anything exported worse than nothing?
	@$(BIN)/python -m trials.examples $(ARGS)

retrain-demo: $(SETUP) ## a simulated year of nightly retraining
	@$(BIN)/python examples/retraining/year.py out/retraining --seed $(SEED) $(ARGS)

attack: $(SETUP) ## ten minutes of hostile files and killed processes
	@$(BIN)/python -m tests.hostile.attack --seconds 500 --kills 1000 --seed $(SEED) $(ARGS)
	@$(BIN)/python -m tests.hostile.registry --kills 1000 --seed $(SEED)
	@$(BIN)/python -m tests.hostile.interrupted --count 200 --seed $(SEED)

lock: $(SETUP) ## write requirements.lock: the versions that are installed
	@$(BIN)/python -m tests.contract.dependencies > requirements.lock

clean: ## remove what was made, and .venv
	@rm -rf $(VENV) build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +
