"""FastTD3 (Seo et al. 2025, arXiv 2505.22642), written anew: parallel off-policy learning with a deterministic actor.

Read in this order: `config` (what can be chosen), `networks` (the critics and their distribution over returns),
`replay` (what is remembered and drawn), `learner` (how these learn). The actor is the network "tanh-mlp" of
`learning.networks`.
"""
