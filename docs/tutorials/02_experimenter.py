"""
The experimenter: a measured G beside a simulated one
=====================================================

You have a vibrometer, a data acquisition chassis and an arm. This page goes the whole way once with a *virtual*
chassis, which plays the sweep through a known G and adds noise, converters and delay: the way to try a protocol
before anybody puts an arm on a table. With hardware the two lines that name the device change, nothing else.
"""

# %%
# The arm that will be measured: softer muscle than the model believes, which is what a person is.
import tempfile
from pathlib import Path

from forearm_fem import simulate
from forearm_fem.scenario import parse_scenario

scene = {
    "name": "subject", "engine": "layered", "sweep": {"f_min": 20.0, "f_max": 400.0, "duration": 0.5},
    "device": {"cone": {"contact": "pressure"}}, "measurement": {"repeats": 4},
}  # fmt: skip
subject = parse_scenario(scene)
believed = simulate(subject).transfer
arm = subject.changed({"tissues.override.muscle.mu": 7000.0})
truth = simulate(arm).transfer

# %%
# **Measure.** One actuator and one point at a time, an exponential sweep repeated without a pause; each of the 36
# recordings is saved when it is taken, and the same line resumes after a stop. On the command line::
#
#     forearm-fem calibrate subject.toml --daq virtual --snr 50
#     forearm-fem calibrate subject.toml --daq ni
from forearm_fem.questions.calibrate import VirtualSetup, run_calibration

folder = Path(tempfile.mkdtemp())
result = run_calibration(arm, folder, daq="virtual", virtual=VirtualSetup(truth, snr_db=50.0), figure=False)
measured = result.measured.transfer
print(f"{len(list(folder.glob('G_*.nc')))} recordings; {100 * measured.valid.mean():.0f} % of the entries may be used")

# %%
# Coherence and the scatter between repeats say how far each entry can be trusted: ``measured.deviation`` is a standard
# deviation per entry. Against the truth, which only a virtual arm has:
from forearm_fem.transfer import band_error

error = band_error(measured.values, truth.values)
print(f"measured against the truth: e_band {error:.4f}")

# %%
# **Compare** with what the model believed: magnitude and phase per entry, correlation over frequency (FRAC), the misfit
# in standard deviations, and S of drives designed on one and played on the other. On the command line::
#
#     forearm-fem compare results/subject/calibration results/subject
from forearm_fem.questions.compare.run import run_compare

comparison = run_compare(measured, believed, render=False)
print("\n".join(comparison.text.splitlines()[:16]))

# %%
# **Fit** what differs. The data say which modulus it was, and with what interval; parameters that they cannot tell
# apart are named.
from forearm_fem.questions.compare.run import run_fit

fitted = run_fit(subject, measured, ["muscle.mu"], frequencies=12)
print(fitted.text)

# %%
# The picture: believed, measured and fitted at the point in the middle.
import matplotlib.pyplot as plt
import numpy as np

figure, axes = plt.subplots(figsize=(3.5, 2.6), layout="constrained")
for name, g, style in (("believed", believed, "--"), ("measured", measured, "."), ("fitted", fitted.model, "o")):
    axes.semilogy(g.frequency, 1e6 * np.abs(g.values[:, 4, 0]), style, label=name, ms=3)
axes.set(xlabel="frequency [Hz]", ylabel="point 5 per volt on A1 [µm/V]")
axes.legend(fontsize=7)

# %%
# What this page promises: the measurement is within a hundredth of the truth, and the fit finds the muscle.
found = next(iter(fitted.fit.values.values()))
assert error < 0.01, error
assert abs(found / 7000.0 - 1) < 0.05, found
