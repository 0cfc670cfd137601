"""Towards target 1: what the grid shows, and what the skin between the points does.

Interpolating nine points, as the thesis had to, misses what happens beside the cones. At t = 0 the inverse filter
moves this corner most of all nine points; on this coarse scene it does not manage that for the edges.
"""

import numpy as np
from common import quick

from forearm_fem.figures import plot_target, target_waves


def main() -> float:
    """Ratio of the target's displacement to the next largest one at t = 0 under the inverse filter."""
    data = target_waves(quick(), "1")
    shown = data.shown[0]
    now = np.abs(shown.values[:, int(np.argmin(np.abs(shown.time)))])
    ratio = float(now[data.row] / np.delete(now, data.row).max())
    assert ratio > 1, ratio
    return ratio


if __name__ == "__main__":
    main()
    plot_target(target_waves(quick(), "1")).savefig("target-1.png")
