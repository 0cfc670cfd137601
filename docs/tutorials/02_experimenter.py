"""
The experimenter: a measured G beside a simulated one
=====================================================

You have a vibrometer, a data acquisition chassis and an arm. This page goes the whole way once with a *virtual*
chassis, which plays the sweep through a known G and adds noise, converters and delay. Try a protocol so
before anybody puts an arm on a table. With hardware one argument changes: ``daq="ni"``.
"""

# %%
# The arm that will be measured has softer muscle than the model believes.
import tempfile
from pathlib import Path

from forearm_fem import calibrate, compare, fit, load_scenario, simulate

keys = ["name='subject'", "engine='layered'", "sweep.f_min=20", "sweep.f_max=400", "sweep.duration=0.5",
        "device.cone.contact='pressure'", "measurement.repeats=4"]  # fmt: skip
subject = load_scenario("thesis", overrides=keys)
believed = simulate(subject).transfer
arm = subject.changed({"tissues.override.muscle.mu": 7000.0})
truth = simulate(arm).transfer

# %%
# **Measure.** One actuator and one point at a time, an exponential sweep repeated without a pause. Each of the 36
# recordings is saved when it is taken, and the same line resumes after a stop. On the command line::
#
#     forearm-fem calibrate subject.toml --daq virtual --snr 60
#     forearm-fem calibrate subject.toml --daq ni
folder = Path(tempfile.mkdtemp())
measured = calibrate(arm, folder, through=truth, figure=False).measured.transfer
print(f"{len(list(folder.glob('G_*.nc')))} recordings; {100 * measured.valid.mean():.0f} % of the entries may be used")

# %%
# The scatter between repeats says how far each entry can be trusted: ``measured.deviation`` is a standard deviation per
# entry. Against the truth, which only a virtual arm has:
import numpy as np

error = np.linalg.norm(measured.values - truth.values) / np.linalg.norm(truth.values)
print(f"measured against the truth: e_band {error:.4f}")

# %%
# **Compare** with what the model believed: where they differ, and the likeliest cause. On the command line::
#
#     forearm-fem compare results/subject/calibration results/subject
print("\n".join(compare(measured, believed, render=False).text.splitlines()[:16]))

# %%
# **Fit** what differs. The data give the modulus and its interval, and name parameters that they cannot tell apart.
fitted = fit(subject, measured, ["muscle.mu"], frequencies=12)
print(fitted.text)

# %%
# The picture: believed, measured and fitted at the point in the middle.
import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(3.5, 2.6), layout="constrained")
for name, g, style in (("believed", believed, "--"), ("measured", measured, "."), ("fitted", fitted.model, "o")):
    axes.semilogy(g.frequency, 1e6 * np.abs(g.sel("5", "A1")), style, label=name, ms=3)
axes.set(xlabel="frequency [Hz]", ylabel="point 5 per volt on A1 [µm/V]")
axes.legend(fontsize=7)

# %%
# What this page promises: the measurement is within a hundredth of the truth, and the fit finds the muscle.
found = next(iter(fitted.fit.values.values()))
assert error < 0.01, error
assert abs(found / 7000.0 - 1) < 0.05, found
