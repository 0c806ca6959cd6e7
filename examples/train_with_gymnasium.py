# %% [markdown]
# # Train with Gymnasium
# Stable-Baselines3's SAC on `sim2real/Fish-v0`, and a film of what it learned.

# %% tags=["parameters"]
OUT = "build/examples"
STEPS = 5000  # 100000 to arrive
FILMED = 500  # steps at most

# %%
from pathlib import Path

import gymnasium
from stable_baselines3 import SAC

import rl  # noqa: F401 - it registers sim2real/Fish-v0
from sim.view.video import FRAMES_PER_S, Video

out = Path(OUT)
out.mkdir(parents=True, exist_ok=True)

# %%
env = gymnasium.make("sim2real/Fish-v0", task="near", render_mode="rgb_array")
agent = SAC("MlpPolicy", env, learning_starts=100, policy_kwargs={"net_arch": [64, 64]}, seed=0)
agent.learn(STEPS)
agent.save(out / "policy.zip")

# %%
seen, _ = env.reset(seed=1)
steps_per_s = env.unwrapped.metadata["render_fps"]
with Video(out / "swim.gif") as video:
    for step in range(1, FILMED + 1):
        action, _ = agent.predict(seen, deterministic=True)
        seen, _, arrived, late, _ = env.step(action)
        for _ in range(round(FRAMES_PER_S / steps_per_s)):
            video.add(env.render())
        if arrived or late or step == FILMED:
            print(f"{out / 'swim.gif'}: {step / steps_per_s:.1f} s")
            break
