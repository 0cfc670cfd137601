"""
Waves in space
==============

A still of the skin and of a cut beneath it, from the reduced basis: no new solve. The same view makes a film
(``animate``) and the workbench is a page for the browser; on the command line ``forearm-fem show results/quick``.
"""

# %%
# A run to draw, as ``forearm-fem run quick`` leaves it in the folder that this script is started in.
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from forearm_fem.show import Results
from forearm_fem.show.film import Look, render_still
from forearm_fem.show.motion import View, motion

run = Results.open("results/quick")
file = Path(tempfile.mkdtemp()) / "still.png"
render_still(run, file, view=View("funneling", "5"), look=Look(cut="y"), at=3e-3)
figure, axes = plt.subplots(figsize=(7.1, 5.3), layout="constrained")
axes.imshow(plt.imread(file))
axes.set_axis_off()

# %%
# What this page promises: next to the only actuator driven the skin moves more than three times as much as two
# centimetres and a half away.
phasor = motion(run, View(frequency=150.0, actuator="A1")).phasor
size = np.abs(run.wavefield.modes[:, 2] @ phasor)
away = np.linalg.norm(run.field_mesh.points - run.transfer.inputs[0].position, axis=1)
ratio = float(size[away < 6e-3].max() / size[(away > 22e-3) & (away < 28e-3)].max())
assert ratio > 3, ratio
