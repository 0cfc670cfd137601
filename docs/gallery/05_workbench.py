"""
The workbench
=============

The run as a page whose model goes on computing: click a point on an arm, hold others still, change the stimulus or the
coils, and see all three methods answer. Below is the page itself, alive. On the command line
``forearm-fem workbench results/quick``; in a notebook ``view("results/quick")`` as the last line of a cell.
"""

# %%
# A run to draw, as ``forearm-fem run quick`` leaves it in the folder that this script is started in.
from forearm_fem.show.workbench import view

page = view("results/quick", height=1000)

# %%
# What this page promises: it is one file below 15 MB, and it reaches no network.
assert len(page.page) < 15e6
assert "default-src 'none'" in page.page
page  # noqa: B018  the last line of a cell is shown
