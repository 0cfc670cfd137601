"""
The engineer: calibrate before hardware exists
==============================================

You design a sleeve with vibration motors. Can it aim at a point of the skin, and how far apart should its actuators
sit? A real calibration takes a laser vibrometer and a day; here the transfer matrix G comes from a model of the arm.

The layered model (``engine = "layered"``), a flat arm without bones, answers in seconds. Leave that key out and the
same script meshes and solves a whole forearm; it takes minutes and adds bones, curvature and cut ends.
"""

# %%
# A scenario is the thesis' device on a default arm wherever it says nothing else. A record of half a second instead of
# two keeps this page quick.
from forearm_fem import load_scenario, render, simulate

keys = ["name='sleeve'", "engine='layered'", "sweep.duration=0.5", "device.cone.contact='pressure'"]
sleeve = load_scenario("thesis", overrides=keys)
simulation = simulate(sleeve)
g = simulation.transfer
print(g)

# %%
# ``g.values`` is ordered (frequency, point, actuator). Every source of error that was estimated comes with it.
for error in g.errors:
    print(f"{error.source}: {error.band:.1e} of G ({error.method})")

# %%
# How much each point moves per volt on each actuator, and within what band that is known. Lines are pale where a point
# may not move at all, for all that is known:
g.plot()

# %%
# **Can it aim?** Signal strength S is the motion of the target over the mean motion of the other eight points: above
# one means that the target moves most. Three methods try all nine targets.
rendering = render(simulation)
rendering.plot()

# %%
# **How far apart should the actuators sit?** Below 45 mm the grid's corner points lie within 9 mm of a rim: they move
# with a motor, and S there does not count. Far apart each actuator is alone. Every spacing is one line.
import matplotlib.pyplot as plt

spacings = [0.045, 0.050, 0.055]
strengths = [render(simulate(sleeve.changed({"device.spacing": s}))).strengths.mean(axis=1) for s in spacings]

figure, axes = plt.subplots(figsize=(3.5, 2.6), layout="constrained")
for name, line in zip(rendering.methods, zip(*strengths, strict=True), strict=True):
    axes.plot([1e3 * s for s in spacings], line, "o-", label=name)
axes.axhline(1, color="grey", lw=0.8)
axes.set(xlabel="spacing of the actuators [mm]", ylabel="S, mean of nine targets")
axes.legend(fontsize=7)

# %%
# What this page promises: at each of these spacings the mean over the targets of the best method is above one.
best = [max(s) for s in strengths]
print({f"{1e3 * a:g} mm": f"{b:.2f}" for a, b in zip(spacings, best, strict=True)})
assert min(best) > 1

# %%
# Next: the same from the command line writes a folder with a report, drives and figures::
#
#     forearm-fem run thesis --set device.spacing=40mm
#
# Your own arm, other arrays and other actuators each have a page under *How-to*.
