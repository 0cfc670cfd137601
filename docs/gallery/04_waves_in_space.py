"""
Waves in space
==============

A cut beneath the skin, from the reduced basis: no new solve. The same view makes a film (``animate``), and the
workbench is a page for the browser; on the command line ``forearm-fem figures results/quick --film waves.gif``.
"""

# %%
# A run to draw, as ``forearm-fem run quick`` leaves it in the folder that this script is started in.
import numpy as np

from forearm_fem.show import Results
from forearm_fem.show.film import Look, plot_wavefield, wavefield
from forearm_fem.show.motion import View, motion

run = Results.open("results/quick")
plot_wavefield(wavefield(run, view=View("funneling", "5"), look=Look(cut="y"), at=3e-3))

# %%
# What this page promises: next to the only actuator driven the skin moves more than three times as much as two
# centimetres and a half away.
phasor = motion(run, View(frequency=150.0, actuator="A1")).phasor
size = np.abs(run.wavefield.modes[:, 2] @ phasor)
away = np.linalg.norm(run.field_mesh.points - run.transfer.inputs[0].position, axis=1)
ratio = float(size[away < 6e-3].max() / size[(away > 22e-3) & (away < 28e-3)].max())
assert ratio > 3, ratio
