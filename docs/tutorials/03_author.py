"""
The author: figures for a paper
===============================

Every figure is a function of an xarray Dataset, in one style, with the numbers it shows in a CSV beside it. This page
makes a folder with the layered model, draws four of them, and shows how to lay your own curve over one.
"""

# %%
# A results folder, as ``forearm-fem run`` leaves it. A forearm's would hold mesh and wavefields too.
import tempfile
from pathlib import Path

from forearm_fem.questions.run import Run, run_render
from forearm_fem.scenario import parse_scenario
from forearm_fem.show import Results, kinds, make_figures

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
from forearm_fem.show import plot_table_one, strengths, table_one

plot_table_one(table_one(strengths(results)))

# %%
# **A wavelet along a line**, the thesis' figure 2. The inverse filter sends low frequencies first, as they travel
# slowly; all meet at the last place.
from forearm_fem.show import plot_travel, travel

data = travel(results)
plot_travel(data)

# %%
# **Your own curve over one of ours.** Functions return the figure they drew, so anything of matplotlib can follow. Here
# the impedance of a coil that is held still, which the amplifier would see without any motion.
import numpy as np

from forearm_fem.show import impedance, plot_impedance

figure = plot_impedance(impedance(results))
frequency, coil = results.transfer.frequency, results.scenario.device.coil
held = np.abs(coil.resistance + 2j * np.pi * frequency * coil.inductance)
figure.axes[2].plot(frequency, held, "k:", label="coil held still")
figure.axes[2].legend()

# %%
# What this page promises: the wavelet peaks at t = 0 at the end of the line, within two tenths of a millisecond.
peak = float(data.time[int(np.argmax(data.u[0, -1].values))])
assert abs(peak) < 2e-4, peak
