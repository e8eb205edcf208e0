# `make` lists what there is. Further options of a verb go into ARGS, such as `make train-stage1 ARGS="--env.seed 2"`.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
need = $(if $($(1)),$($(1)),$(error $@ needs $(1)=..., such as `make $@ $(1)=$(2)`))

.DEFAULT_GOAL := help
.PHONY: help setup train-stage1 train-stage2 ramps calibrate curve terrain list bench test lint types check format clean

help: ## List these verbs
	@awk -F ':.*## ' '/^[a-z0-9-]+:.*## / {printf "  %-13s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP) ## Install into .venv; every other verb does so by itself

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
	  { echo "HumoSlope needs Python 3.11 or newer with its venv module (on Debian: apt install python3-venv)." >&2; exit 1; }
	@echo "Installing into .venv; the first time takes some minutes."
	@$(PYTHON) -m venv .venv
	@$(BIN)/pip install -qq --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

train-stage1: $(STAMP) ## Train Stage I; ARGS="--resume latest" goes on with the newest run
	$(BIN)/humoslope train HumoSlope-Stage1-Unitree-G1 $(ARGS)

train-stage2: $(STAMP) ## Train Stage II from the newest Stage I and its calibration
	$(BIN)/humoslope train HumoSlope-Stage2-Unitree-G1 $(ARGS)

ramps: $(STAMP) ## Evaluate CHECKPOINT on flat ground and on ramps
	$(BIN)/humoslope ramps $(call need,CHECKPOINT,logs/.../model_1000.pt) $(ARGS)

calibrate: $(STAMP) ## Fit the swing reference of Stage II to the Stage-I CHECKPOINT
	$(BIN)/humoslope calibrate $(call need,CHECKPOINT,logs/.../model_1000.pt) $(ARGS)

curve: $(STAMP) ## Draw the learning curve of RUN, a run folder
	$(BIN)/humoslope curve $(call need,RUN,logs/...) $(ARGS)

terrain: $(STAMP) ## Draw the terrain NAME to a PNG
	$(BIN)/humoslope terrain $(call need,NAME,ramp-up) $(ARGS)

list: $(STAMP) ## List the registered tasks and terrains
	@$(BIN)/humoslope list $(ARGS)

bench: $(STAMP) ## Measure speed and memory of Stage I; ARGS="--checkpoint ..." with robots that walk
	$(BIN)/humoslope bench HumoSlope-Stage1-Unitree-G1 $(ARGS)

test: $(STAMP) ## Run the tests with their coverage; ARGS=tests/cli runs some, without it
	$(BIN)/python -m pytest $(or $(ARGS),--cov --cov-report=term:skip-covered --cov-fail-under=85)

lint: $(STAMP) ## Check style and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP) ## Check types
	$(BIN)/mypy

check: lint types test ## Everything that must pass before a commit

format: $(STAMP) ## Put code into its format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean: ## Remove caches and build leftovers; .venv and logs stay
	rm -rf .mypy_cache .pytest_cache .ruff_cache .hypothesis .coverage MUJOCO_LOG.TXT build src/*.egg-info
	find src robots terrains tasks tests -name __pycache__ -type d -exec rm -rf {} +
