"""
A key changed and swept
=======================

How does S of the middle point depend on the spacing of the actuators? Change the key of a scenario, simulate, and put
the answers side by side as labelled arrays. The page can be downloaded as a notebook.
"""

# %%
# **One scenario**, on the layered model, a second for each device. `changed` refuses unknown keys and impossible values
# in a sentence.
from forearm_fem import ForearmError, load_scenario, simulate

scene = load_scenario("quick").changed({"engine": "layered", "rendering.targets": ["5"]})
try:
    scene.changed({"device.spacing": -0.04})
except ForearmError as problem:
    print(problem)

# %%
# **The answer** is a simulation. G and S print in a line, and know points and actuators by name.
base = simulate(scene)
print(repr(base.transfer))
print(repr(base.strength))
entry = base.strength.sel("inverse filter", "5")
print(f"S of the inverse filter at 5: {entry.value:.2f} ({entry.low:.2f} to {entry.high:.2f})")

# %%
# **The sweep** is a loop; xarray puts the answers side by side.
import xarray as xr

spacings = [0.036, 0.040, 0.044]
swept = xr.concat(
    [simulate(scene.changed({"device.spacing": s})).strength.to_xarray() for s in spacings],
    dim=xr.Variable("spacing", spacings, {"units": "m"}),
)
values = swept["value"].sel(target="5")
print(values.to_pandas().round(2))

# %%
# The picture, with each S within its interval.
import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(3.5, 2.6), layout="constrained")
for name in swept["renderer"].values:
    s = swept.sel(renderer=name, target="5")
    axes.plot(1e3 * s["spacing"], s["value"], "o-", label=name, ms=3)
    axes.fill_between(1e3 * s["spacing"], s["low"], s["high"], alpha=0.2)
axes.set(xlabel="spacing [mm]", ylabel="S at point 5")
axes.legend(fontsize=7)

# %%
# What this page promises: each interval holds its value.
assert bool((swept["low"] <= swept["value"]).all())
assert bool((swept["value"] <= swept["high"]).all())
