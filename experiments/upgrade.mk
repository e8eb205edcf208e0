# How the shipped checkpoints were brought into the second format, with the options that their trainings ended with.
# OLD is a folder with the files of the first format, such as those of commit 454d066.
BIN ?= .venv/bin
OLD ?= old
NEW ?= experiments/checkpoints

STAGE1 := --preset cpu --env.num-envs 1024 --agent.entropy-coef 0.001 --env.rewards.track-velocity.params.std 0.25
STAGE2 := --preset cpu --env.num-envs 1024 --agent.max-iterations 2800 --agent.entropy-coef 0.0 \
  --env.rewards.com-height.params.std 0.05 --env.rewards.com-height.weight 2.0 --env.rewards.arm-deviation.weight -0.5 \
  --env.rewards.swing-hip.params.beta0 0.5296826606255995 --env.rewards.swing-hip.params.beta1 0.019403794508190342
URL := --preset cpu --env.num-envs 1024 --agent.max-iterations 2600 --agent.init-std 0.8 --agent.obs-normalization \
  --agent.symmetry --agent.entropy-coef 0.003 --agent.critic-warmup-iterations 40

.PHONY: all
all:
	$(BIN)/humoslope upgrade $(OLD)/stage1.pt --out $(NEW)/stage1.pt --options="$(STAGE1)"
	$(BIN)/humoslope upgrade $(OLD)/stage2.pt --out $(NEW)/stage2.pt --options="$(STAGE2)"
	$(BIN)/humoslope upgrade $(OLD)/url.pt --out $(NEW)/url.pt --options="$(URL)"
