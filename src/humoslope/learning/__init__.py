"""Learning with rsl_rl: configuration, environment face, symmetry, runner, checkpoints."""
