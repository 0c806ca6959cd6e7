# %% [markdown]
# # Posterior and ranges
# How certain the identified parameters are, and the ranges that training should draw from.

# %% tags=["parameters"]
OUT = "build/examples"
STEPS = 1000  # of each chain

# %%
from pathlib import Path

import sim2real as s2r
from sim2real.example import BENCH
from sim2real.ranges.entry import write_ranges

out = Path(OUT)
out.mkdir(parents=True, exist_ok=True)

# %%
recordings = [BENCH / "steps.csv", BENCH / "square.csv"]
model = s2r.identify(recordings, BENCH / "robot.toml")
found = s2r.ranges(recordings, BENCH / "robot.toml", model, steps=STEPS, walkers=16, seed=1)
write_ranges(found.ranges, out / "ranges.json")
print(found)

# %%
figure = found.plot()
figure.savefig(out / "latency.png")
figure
