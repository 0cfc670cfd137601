"""
From a lab's CSV to S, and a fit
================================

The program asks for what a file does not state, and never guesses. From there on a measured G is like a simulated one.
The page can be downloaded as a notebook.
"""

# %%
# **The file.** A lab would bring it; here it is made from a model of an arm whose muscle is softer than the scenario's.
import tempfile
from pathlib import Path

from forearm_fem import fit, load_scenario, read, render, simulate

scene = load_scenario("quick").changed({"engine": "layered", "rendering.targets": ["5"]})
softer = simulate(scene.changed({"tissues.override.muscle.mu": 7000.0})).transfer
file = Path(tempfile.mkdtemp()) / "lab.csv"
softer.save(file)

# %%
# **G of the file**, with the points and actuators of the scenario that was measured.
g = read(file, scenario=scene)
print(repr(g))
print(g.to_xarray().sel(output="5", input="A1").sel(frequency=200.0, method="nearest").values)

# %%
# **S on it**: the same renderers, wavelet and window as on a simulated G.
played = render(g, scene)
print(repr(played.strength))

# %%
# **A fit**: which muscle brings the model's G nearest to the file's? The answer has an interval.
found = fit(scene, g, ["muscle.mu"], frequencies=12)
print(repr(found))
value, low, high = found.sel("muscle.mu")
print(f"muscle.mu {value:.0f} Pa ({low:.0f} to {high:.0f})")

# %%
# The picture: where it lies in the range that was allowed.
figure = found.plot()

# %%
# What this page promises: the fit finds the muscle.
assert abs(value / 7000.0 - 1) < 0.05, value
