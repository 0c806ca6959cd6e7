# %% [markdown]
# # Identify a servo
# Recordings of three servos to a model, scored on a chirp that the fit has not seen.

# %% tags=["parameters"]
OUT = "build/examples"

# %%
from pathlib import Path

import sim2real as s2r
from sim2real.example import BENCH

out = Path(OUT)
out.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# The last recording is held out. Each parameter comes with its 90 % interval.

# %%
recordings = [s2r.read_recording(BENCH / f"{name}.csv") for name in ("steps", "square", "chirp")]
model = s2r.identify(recordings, BENCH / "robot.toml")
s2r.write_model(model, out / "model.json")
print(model)

# %% [markdown]
# The model on the commands of the chirp, and what was measured:

# %%
prediction = s2r.predict(recordings[-1], BENCH / "robot.toml", model)
print(prediction)
figure = prediction.plot(joint="j1")
figure.savefig(out / "chirp.png")
figure
