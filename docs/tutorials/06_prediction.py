"""
A prediction over arms
======================

What will S be on people? Arms differ in their tissues, thicknesses, tension and contact; each draw is an arm. The page
can be downloaded as a notebook.
"""

# %%
# **The question**: a scenario, and how many arms. Twenty are the least for a band of 90 %; a folder keeps what is done,
# so that the same call with more draws goes on. With ``workers=1`` no further processes are started.
import tempfile

from forearm_fem import load_scenario, predict

scene = load_scenario("quick").changed({"engine": "layered", "rendering.targets": ["5"]})
folder = tempfile.mkdtemp()
people = predict(scene, draws=20, folder=folder, workers=1)
print(repr(people))

# %%
# **S of every arm** by method and target, and what drives it.
strengths = people.sel("inverse filter", "5")
print(f"{(strengths > 1).mean():.0%} of the arms above S = 1")
table = people.to_xarray()
print(table["drivers"].to_pandas().iloc[:3, :4])

# %%
# The picture: bars span 5-95 % and 25-75 % of arms; the cross is the scene itself with its numerical interval. Never
# add the two.
figure = people.plot()

# %%
# **Kept**: page, pictures and numbers, as `forearm-fem predict` writes them.
page, _ = people.save(folder, sobol=False)
print(page.name)

# %%
# What this page promises: the same draws again, and none made twice.
again = predict(scene, draws=20, folder=folder, workers=1)
assert again.reused == 20
assert (again.sel("inverse filter", "5") == strengths).all()
