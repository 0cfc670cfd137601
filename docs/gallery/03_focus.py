"""
Towards a corner
================

What the grid shows, and what the skin between the points does. Interpolating nine points, as the thesis had to, misses
what happens beside the cones.
"""

# %%
# A run to draw, as ``forearm-fem run quick`` leaves it in the folder that this script is started in.
import numpy as np

from forearm_fem.show import Results, plot_target, target_waves

data = target_waves(Results.open("results/quick"), "1")
plot_target(data)

# %%
# What this page promises: at t = 0 the inverse filter moves this corner most of all nine points. On this coarse scene
# it does not manage that for the edges.
now = np.abs(data.u.sel({"method": "inverse filter"}).sel(time=0, method="nearest"))
ratio = float(now.sel(output="1") / now.drop_sel(output="1").max())
assert ratio > 1, ratio
