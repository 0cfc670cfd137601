"""
The transfer matrix
===================

How a voltage becomes motion: size and phase of G at every grid point. The nearest point of each actuator moves most;
beyond it the skin damps high frequencies away. Each line lies in the band that it is known to, all sources of error
together. Far points move little: where they may not move at all, for all that is known, their lines are pale.
"""

# %%
# A run to draw, as ``forearm-fem run quick`` leaves it in the folder that this script is started in.
import numpy as np

from forearm_fem.show import Results, conditioning, plot_conditioning, plot_transfer, transfer_of

run = Results.open("results/quick")
plot_transfer(transfer_of(run.transfer))

# %%
# A condition number near one says that the four actuators can be told apart, so that an inverse filter does not amplify
# errors of G.
data = conditioning(run)
plot_conditioning(data)

# %%
# What this page promises: over the band the median condition number is between one and two.
median = float(np.median(data.condition))
assert 1 < median < 2, median
