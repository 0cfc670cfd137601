"""
The author: figures for a paper
===============================

The figures of the thesis come from a results folder and one command, in one style, each with its numbers as CSV::

    forearm-fem run thesis --out results/paper
    forearm-fem figures results/paper --only figure-6,table-1 --format pdf

This page is about the rest: numbers as arrays and tables, and a curve of yours over one of ours.
"""

# %%
# The layered model keeps this page quick; the lines are the same for a forearm.
import tempfile
from pathlib import Path

from forearm_fem import load_scenario, render, simulate

keys = ["name='paper'", "engine='layered'", "sweep.duration=0.5", "device.cone.contact='pressure'"]
simulation = simulate(load_scenario("thesis", overrides=keys))
rendering = render(simulation)

# %%
# **S with its interval**, by target and method, and as the table that a report has.
rendering.strength.plot()

# %%
print(rendering.table().as_text())

# %%
# **Arrays with names.** G, S, drives and displacements become xarray, and pandas from there.
print(rendering.strength.to_xarray()["value"].to_pandas().round(2))

# %%
# **Files**: S as CSV, G as netCDF, CSV or MATLAB by the ending.
folder = Path(tempfile.mkdtemp())
rendering.strength.save(folder / "signal_strength.csv")
simulation.save(folder / "G.mat")
print(sorted(file.name for file in folder.iterdir()))

# %%
# **Your own curve over one of ours.** ``plot()`` returns the figure, so anything of matplotlib can follow. Here the
# waves at the target by two methods, and a wavelet of one's own over them.
import matplotlib.pyplot as plt
import numpy as np

figure, axes = plt.subplots(figsize=(3.5, 2.6), layout="constrained")
for method in ("inverse filter", "combination"):
    moved = rendering.sel(method, "5").displacements
    target = moved.values[moved.names.index("5")]
    axes.plot(1e3 * moved.time, target / np.abs(target).max(), label=method)
time = np.linspace(-0.02, 0.02, 400)
argument = (np.pi * 250 * time) ** 2
axes.plot(1e3 * time, (1 - 2 * argument) * np.exp(-argument), "k:", label="Ricker, 250 Hz")
axes.set(xlim=(-20, 20), xlabel="time [ms]", ylabel="motion of point 5, scaled")
axes.legend(fontsize=7)

# %%
# What this page promises: under the inverse filter the target peaks at the wavelet's own time. Its size is not met:
# five conditions are more than four actuators can hold.
moved = rendering.sel("inverse filter", "5").displacements
target = moved.values[moved.names.index("5")]
peak = float(moved.time[int(np.argmax(target))])
assert abs(peak) < 2e-4, peak
