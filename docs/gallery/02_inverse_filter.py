"""
A wavelet delivered at the end of a line
========================================

The thesis' figure 2. The inverse filter sends low frequencies first, since they travel slowly, and high ones later; all
meet at the last place as the wavelet asked for. On the way the skin moves more than at the target.
"""

# %%
# A run to draw, as ``forearm-fem run quick`` leaves it in the folder that this script is started in.
import numpy as np

from forearm_fem.show import Results, plot_travel, travel

data = travel(Results.open("results/quick"))
plot_travel(data)

# %%
# What this page promises: the last place peaks at the wavelet's centre, and the first one moves more.
peak = float(data.time[int(np.argmax(data.u[0, -1].values))])
assert abs(peak) < 2e-4, peak
assert np.abs(data.u[0, 0]).max() > np.abs(data.u[0, -1]).max()
