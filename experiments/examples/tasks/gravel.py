from humoslope.registry import TaskCfg, task
from humoslope.terrain import TerrainGridCfg
from tasks.stage1 import stage1


@task("HumoSlope-Gravel-Unitree-G1")
def gravel() -> TaskCfg:
    """Stage I on gravel."""
    cfg = stage1()
    cfg.env.scene.terrain = TerrainGridCfg(columns={"gravel-ramp": 0.6, "hillside": 0.4})
    cfg.env.rewards.zmp.weight = 0.25  # a term is changed
    cfg.env.rewards.energy = None  # or taken away
    return cfg
