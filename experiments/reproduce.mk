# The whole campaign from nothing: both stages and the baseline are trained and measured. `make reproduce` runs it and
# goes on where it was stopped; `make -n reproduce` prints it. Everything is written to OUT.
#
# On two CPU cores each of the three trainings takes two to three hours, each full evaluation about twenty minutes. A GPU
# is found by itself; give it more to do: `make reproduce ARGS="WORLDS=4096 ITERATIONS=3000"`. That is an estimated hour for
# each training on an RTX 4090, if it makes the 82,000 steps/s that Isaac Lab reports for its G1 there; it was never run.
OUT ?= logs/reproduce
WORLDS ?= 1024
ITERATIONS ?= 2600
BIN ?= .venv/bin

LAST := model_$(shell expr $(ITERATIONS) - 1).pt
METHODS := stage1 stage2 url
HELD_OUT := $(METHODS:%=$(OUT)/heldout/%.json)
SWEEP := $(METHODS:%=$(OUT)/sweep/%.json)

# The baseline learns as Stage I does, so that the two differ in rewards and in what the critic sees alone. Its rewards
# find no first step on so few samples (log.md, "The baseline"): it takes over the actor that Stage I has after WALKS
# iterations, which has just begun to walk in the full harness.
RECIPE := --agent.init-std 0.8 --agent.obs-normalization --agent.symmetry --agent.entropy-coef 0.003 --agent.final-entropy-coef 0.0005 --agent.critic-warmup-iterations 40
WALKS ?= 100

# A run that was stopped goes on: $(call train,RUN,TASK,OPTIONS OF A NEW RUN)
train = $(BIN)/humoslope train $(2) $(if $(wildcard $(OUT)/$(1)/model_*.pt),--resume $(OUT)/$(1),--run-dir $(OUT)/$(1) \
  --env.num-envs $(WORLDS) --agent.max-iterations $(ITERATIONS) $(3))

.PRECIOUS: $(OUT)/%/$(LAST)
.PHONY: campaign
campaign: $(OUT)/ramps.json $(HELD_OUT) $(SWEEP)
	$(BIN)/humoslope table 1 $(OUT)/heldout $(OUT)/sweep --out $(OUT)/table1
	$(BIN)/humoslope table 2 $(OUT)/heldout $(OUT)/sweep --out $(OUT)/table2
	$(BIN)/humoslope figures $(OUT)/heldout $(OUT)/sweep --out $(OUT)/figures

$(OUT)/stage1/$(LAST):
	$(call train,stage1,HumoSlope-Stage1-Unitree-G1)

$(OUT)/stage1/swing.json: $(OUT)/stage1/$(LAST)
	$(BIN)/humoslope calibrate $< --out $@

$(OUT)/stage2/$(LAST): $(OUT)/stage1/$(LAST) $(OUT)/stage1/swing.json
	$(call train,stage2,HumoSlope-Stage2-Unitree-G1,--init $< --calibration $(OUT)/stage1/swing.json)

$(OUT)/url/$(LAST): $(OUT)/stage1/$(LAST)
	$(call train,url,URL-TerrainRelative-Unitree-G1,--init $(OUT)/stage1/model_$(WALKS).pt $(RECIPE))

$(OUT)/ramps.json: $(OUT)/stage1/$(LAST)
	$(BIN)/humoslope ramps $< --out $@

$(HELD_OUT): $(OUT)/heldout/%.json: $(OUT)/%/$(LAST)
	$(BIN)/humoslope evaluate $< --out $(@:.json=)

$(SWEEP): $(OUT)/sweep/%.json: $(OUT)/%/$(LAST)
	$(BIN)/humoslope evaluate $< --sweep --out $(@:.json=)
