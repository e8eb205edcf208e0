# `make` lists the verbs. Options go into ARGS, such as `make train-stage1 ARGS="--env.seed 2"`; `.venv/bin/humoslope VERB`
# takes them as they are, without the quotes.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
DOCS_STAMP := .venv/.docs
RESULTS ?= experiments/results/heldout experiments/results/sweep
ROLLOUT ?= experiments/rollouts/stage2_track20.npz
need = $(if $($(1)),$($(1)),$(error $@ needs $(1)=..., such as `make $@ $(1)=$(2)`))

.DEFAULT_GOAL := help
.PHONY: help setup demo train-stage1 train-stage2 calibrate ramps evaluate table1 table2 figures curve compare record replay video meshes \
  dashboard report export import play terrain bench check-device campaign reproduce recipe drills wheel test lint types docs check format clean

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

$(DOCS_STAMP): $(STAMP)
	@$(BIN)/pip install -qq --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@

demo: $(STAMP) ## Show the shipped policy on a slope, live; ARGS="--grade -15 --view browser"
	$(BIN)/humoslope demo $(ARGS)

train-stage1: $(STAMP) ## Train Stage I; ARGS="--resume latest" goes on with the newest run
	$(BIN)/humoslope train HumoSlope-Stage1-Unitree-G1 $(ARGS)

train-stage2: $(STAMP) ## Train Stage II from the newest Stage I and its calibration
	$(BIN)/humoslope train HumoSlope-Stage2-Unitree-G1 $(ARGS)

ramps: $(STAMP) ## Evaluate CHECKPOINT on flat ground and on ramps
	$(BIN)/humoslope ramps $(call need,CHECKPOINT,logs/.../model_1000.pt) $(ARGS)

evaluate: $(STAMP) ## Evaluate CHECKPOINT on the held-out track; ARGS="--trials 16" is a first look, ARGS=--sweep finds the slope limit
	$(BIN)/humoslope evaluate $(call need,CHECKPOINT,logs/.../model_1000.pt) $(ARGS)

calibrate: $(STAMP) ## Fit the swing reference of Stage II to the Stage-I CHECKPOINT
	$(BIN)/humoslope calibrate $(call need,CHECKPOINT,logs/.../model_1000.pt) $(ARGS)

table1: $(STAMP) ## Print the paper's table 1 with the RESULTS of evaluations: files, NAME=FILE, folders
	$(BIN)/humoslope table 1 $(RESULTS) $(ARGS)

table2: $(STAMP) ## Print the paper's table 2 with the RESULTS of evaluations
	$(BIN)/humoslope table 2 $(RESULTS) $(ARGS)

figures: $(STAMP) ## Draw the RESULTS of evaluations to experiments/figures
	$(BIN)/humoslope figures $(RESULTS) --out experiments/figures $(ARGS)

curve: $(STAMP) ## Draw the learning curve of RUN, a run folder
	$(BIN)/humoslope curve $(call need,RUN,logs/...) $(ARGS)

dashboard: $(STAMP) ## Show the curves of RUN (by default the newest one) in the terminal, as they grow
	$(BIN)/humoslope dashboard $(RUN) $(ARGS)

report: $(STAMP) ## Write one HTML page of RUNS, run folders or checkpoints: what is known of them, and what is missing
	$(BIN)/humoslope report $(call need,RUNS,"logs/a logs/b") $(ARGS)

compare: $(STAMP) ## Compare RUNS, run folders, after equally many environment steps
	$(BIN)/humoslope compare $(call need,RUNS,"logs/a logs/b") $(ARGS)

record: $(STAMP) ## Let CHECKPOINT walk once; ARGS="--terrain ramp-up --grade 30" says where
	$(BIN)/humoslope record $(call need,CHECKPOINT,logs/.../model_1000.pt) $(ARGS)

replay: $(STAMP) ## Show ROLLOUT (by default a shipped one) in rerun; ARGS=--web in a browser
	$(BIN)/humoslope replay $(ROLLOUT) $(ARGS)

video: $(STAMP) ## Make an mp4 and a contact sheet of ROLLOUT, without a display
	$(BIN)/humoslope video $(ROLLOUT) $(ARGS)

export: $(STAMP) ## Export CHECKPOINT: ONNX, a contract, and Unitree's deploy.yaml
	$(BIN)/humoslope export $(call need,CHECKPOINT,logs/.../model_1000.pt) $(ARGS)

import: $(STAMP) ## Make an export of SOURCE, a policy that was trained elsewhere: an ONNX file, a deploy.yaml, or holosoma-ppo
	$(BIN)/humoslope import $(call need,SOURCE,holosoma-ppo) $(ARGS)

play: $(STAMP) ## Walk with the export in DIR, steered by keys, sliders or a gamepad; ARGS="--headless --trials 64" counts falls
	$(BIN)/humoslope play $(call need,DIR,logs/.../model_1000.export) $(ARGS)

meshes: $(STAMP) ## Fetch the robot's real meshes, for ARGS=--meshes of replay and video
	$(BIN)/humoslope meshes $(ARGS)

terrain: $(STAMP) ## Draw the terrain NAME to a PNG
	$(BIN)/humoslope terrain $(call need,NAME,ramp-up) $(ARGS)

bench: $(STAMP) ## Measure speed and memory of Stage I; ARGS="--checkpoint ..." with robots that walk
	$(BIN)/humoslope bench HumoSlope-Stage1-Unitree-G1 $(ARGS)

check-device: $(STAMP) ## Check that this installation is right and fast, within ten minutes; ARGS=--quick is shorter
	$(BIN)/humoslope check HumoSlope-Stage1-Unitree-G1 --checkpoint experiments/checkpoints/stage1.pt \
	  --curve experiments/results/stage1_curve.csv $(ARGS)

campaign: $(STAMP) ## Run the trainings and evaluations of FILE, go on with them; ARGS=--dry-run says what is left
	$(BIN)/humoslope campaign $(call need,FILE,experiments/table2.toml) $(ARGS)

reproduce: $(STAMP) ## Train and measure everything anew, some thirteen hours on two cores; experiments/reproduce.toml states it
	$(BIN)/humoslope campaign experiments/reproduce.toml $(ARGS)
ifeq ($(filter --dry-run --pack% --out%,$(ARGS)),)
	$(BIN)/humoslope table 1 logs/reproduce --out logs/reproduce/tables/table1
	$(BIN)/humoslope table 2 logs/reproduce --out logs/reproduce/tables/table2
	$(BIN)/humoslope figures logs/reproduce --out logs/reproduce/figures
endif

recipe: $(STAMP) ## Compare changes to the CPU recipe in short trainings, some ninety minutes on one core
	$(BIN)/humoslope campaign experiments/recipe.toml $(ARGS)
ifeq ($(filter --dry-run --pack% --out%,$(ARGS)),)
	$(BIN)/humoslope compare logs/recipe --out experiments/results/recipe.md
endif

wheel: $(STAMP) ## Build the wheel, which holds all tasks, terrains, robots and shipped results, into dist
	$(BIN)/pip wheel -q --disable-pip-version-check --no-deps --no-build-isolation -w dist .

test: $(STAMP) ## Run the tests with their coverage; ARGS=tests/cli runs some, without it
	$(BIN)/python -m pytest $(or $(ARGS),-n auto --dist worksteal --cov --cov-report=term:skip-covered --cov-fail-under=85)

drills: $(STAMP) ## Kill, stop, damage and misuse everything; goes on where it was; ARGS="--options 100" is shorter
	$(BIN)/python -m tests.drills $(ARGS)

lint: $(STAMP) ## Check style and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP) ## Check types
	$(BIN)/mypy

docs: $(DOCS_STAMP) ## Build the pages to docs/_build/html; a warning is an error
	$(BIN)/python -m sphinx -W --keep-going -q -d docs/_build/doctrees docs docs/_build/html $(ARGS)
	@echo "wrote docs/_build/html/index.html"

check: lint types test ## Everything that must pass before a commit

format: $(STAMP) ## Put code into its format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean: ## Remove caches and build leftovers; .venv and logs stay
	rm -rf .mypy_cache .pytest_cache .ruff_cache .hypothesis .coverage MUJOCO_LOG.TXT build docs/_build src/*.egg-info
	find src robots terrains tasks tests -name __pycache__ -type d -exec rm -rf {} +
