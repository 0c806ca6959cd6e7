"""Stable-Baselines3's own SAC on ``sim2real/Fish-v0``, and a film of what it learned."""

import argparse
from pathlib import Path

import gymnasium
from stable_baselines3 import SAC

import rl  # noqa: F401 - it registers sim2real/Fish-v0
from sim.view.video import FRAMES_PER_S, Video


def main() -> None:
    """Train, then film one episode."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/examples"))
    parser.add_argument("--steps", type=int, default=5000, help="100000 to arrive (default 5000)")
    parser.add_argument("--filmed", type=int, default=500, help="steps at most (default 500)")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    env = gymnasium.make("sim2real/Fish-v0", task="near", render_mode="rgb_array")
    agent = SAC("MlpPolicy", env, learning_starts=100, policy_kwargs={"net_arch": [64, 64]}, seed=0)
    agent.learn(options.steps)
    agent.save(options.out / "policy.zip")

    seen, _ = env.reset(seed=1)
    steps_per_s = env.unwrapped.metadata["render_fps"]
    with Video(options.out / "swim.gif") as video:
        for step in range(1, options.filmed + 1):
            action, _ = agent.predict(seen, deterministic=True)
            seen, _, arrived, late, _ = env.step(action)
            for _ in range(round(FRAMES_PER_S / steps_per_s)):
                video.add(env.render())
            if arrived or late or step == options.filmed:
                print(f"{options.out / 'swim.gif'}: {step / steps_per_s:.1f} s")
                break


if __name__ == "__main__":
    main()
