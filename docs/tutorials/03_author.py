"""
The author: figures for a paper
===============================

Every figure is a function of a results folder, in one style, with the numbers it shows in a CSV beside it. This page
makes a folder with the flat twin, draws four of them, and shows how to lay your own curve over one.
"""

# %%
# A results folder, as ``forearm-fem run`` leaves it. A forearm's would hold mesh and wavefields too.
import tempfile
from pathlib import Path

from forearm_fem.figures import Results, kinds, make_figures
from forearm_fem.pipeline.folder import Run, run_render
from forearm_fem.scenario import parse_scenario

scene = parse_scenario({"name": "paper", "engine": "layered", "sweep": {"duration": 0.5},
                        "device": {"cone": {"contact": "pressure"}}})  # fmt: skip
folder = Path(tempfile.mkdtemp()) / "paper"
run_render(Run.start(scene, folder, Path()))
results = Results.open(folder)
print(", ".join(kinds(results)))

# %%
# **One call for files**: PNG to look at, PDF or SVG for the journal, CSV for the reviewer. The command is
# ``forearm-fem figures results/paper``.
made = make_figures(results, only=["table-1", "condition"], formats=("png", "pdf"))
print(sorted(file.name for file in made))

# %%
# **Signal strength** beside the thesis' Table I. Dots are targets, bars are the thesis' mean and deviation.
from forearm_fem.figures import plot_table_one, strengths

plot_table_one(strengths(results))

# %%
# **A wavelet along a line**, the thesis' figure 2. The inverse filter sends low frequencies first, as they travel
# slowly; all meet at the last place.
from forearm_fem.figures import plot_travel, travel

data = travel(results)
plot_travel(data)

# %%
# **Your own curve over one of ours.** Functions take the axes to draw on and return what they drew on, so anything of
# matplotlib can follow.
import matplotlib.pyplot as plt
import numpy as np

from forearm_fem.figures import impedance, plot_impedance

figure, axes = plt.subplots(1, 2, figsize=(7.1, 2.6), layout="constrained")
g = results.transfer
axes[0].semilogy(g.frequency, 1e6 * np.abs(g.values[:, 0, 0]))
axes[0].set(xlabel="frequency [Hz]", ylabel="point 1 per volt on A1 [µm/V]")
axes[1].semilogy(g.frequency, np.linalg.cond(g.values))
axes[1].set(xlabel="frequency [Hz]", ylabel="condition number of G")

plot_impedance(impedance(results))

# %%
# What this page promises: the wavelet peaks at t = 0 at the end of the line, within two tenths of a millisecond.
peak = float(data.time[int(np.argmax(data.moved[0][-1]))])
assert abs(peak) < 2e-4, peak
