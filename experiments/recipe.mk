# The comparisons behind the CPU recipe: short trainings of Stage I from nothing, each with one thing changed.
# `make recipe` runs those that are missing, goes on with one that was stopped, and writes the table that log.md reads.
OUT ?= logs/recipe
TABLE ?= experiments/results/recipe.md
ITERATIONS ?= 200
BIN ?= .venv/bin

RUNS := recipe second-seed more-exploration no-history five-epochs finer-physics faster-withdrawal no-harness no-symmetry half-rewards

recipe :=
second-seed := --env.seed 2
more-exploration := --agent.entropy-coef 0.01
no-history := --env.observations.actor.history 1
five-epochs := --agent.num-learning-epochs 5
# As in evaluation, instead of two steps of 10 ms.
finer-physics := --env.sim.timestep 0.005 --env.sim.decimation 4
faster-withdrawal := --env.curriculum.harness.params.rate 0.0166
no-harness := --env.events.harness.params.scale 0
no-symmetry := --agent.no-symmetry
# Without the options this run would be the plain recipe under another name, so a failure must end it.
half-rewards = $(or $(shell $(BIN)/python -c "from tasks.stage1 import stage1; \
  print(*(f'--env.rewards.{name}.weight {term.weight / 2}' for name, term in stage1().env.rewards.items()))"),$(error \
  half-rewards: $(BIN)/python cannot list the rewards of Stage I; see the message above))

LAST := model_$(shell expr $(ITERATIONS) - 1).pt
DONE := $(RUNS:%=$(OUT)/%/$(LAST))

.PRECIOUS: $(OUT)/%/$(LAST)
$(TABLE): $(DONE)
	$(BIN)/humoslope compare $(RUNS:%=$(OUT)/%) --out $@

$(OUT)/%/$(LAST):
	$(BIN)/humoslope train HumoSlope-Stage1-Unitree-G1 $(if $(wildcard $(@D)/model_*.pt),--resume $(@D), \
	  --preset cpu --run-dir $(@D) --env.num-envs 512 --agent.max-iterations $(ITERATIONS) $($*))
