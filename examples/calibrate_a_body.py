# %% [markdown]
# # Calibrate a body
# A swim in a pool to a calibrated body, in the reduced-order twin of the fluid.

# %% tags=["parameters"]
OUT = "build/examples"
SECONDS = 30.0  # of the swim

# %%
from pathlib import Path

import sim2real as s2r
from sim2real.example import POOL

out = Path(OUT)
out.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# The end of the swim is held out.

# %%
swim = s2r.read_recording(POOL / "p1.csv")
swim = swim.between(0, int((swim.t <= swim.t[0] + SECONDS).sum()))
found = s2r.calibrate(swim, POOL / "robot.toml", POOL / "model.json")
s2r.write_model(found.model, out / "calibrated.json")
print(found)

# %%
figure = found.plot()
figure.savefig(out / "calibration.png")
figure
