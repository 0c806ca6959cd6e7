"""Reinforcement learning of swimming; on import registers ``sim2real/Fish-v0`` with Gymnasium."""

from importlib.util import find_spec

if find_spec("gymnasium") is not None:  # optional: exported policies need only NumPy
    from gymnasium.envs.registration import register

    register(
        id="sim2real/Fish-v0",
        entry_point="rl.env:make_fish",
        vector_entry_point="rl.env:make_fish_vec",
    )
