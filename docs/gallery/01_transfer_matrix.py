"""How a voltage becomes motion: |G| and phase of every grid point, and the condition number of G.

The nearest point of each actuator moves most; beyond it the skin damps high frequencies away. A condition number
near 1 says that the four actuators can be told apart, so that an inverse filter does not amplify errors of G.
"""

import numpy as np
from common import quick

from forearm_fem.figures import conditioning, plot_conditioning, plot_transfer


def main() -> float:
    """Median condition number of G over the band."""
    run = quick()
    median = float(np.median(conditioning(run).condition))
    assert 1 < median < 2, median
    return median


if __name__ == "__main__":
    main()
    plot_transfer(quick().transfer).savefig("transfer.png")
    plot_conditioning(conditioning(quick())).savefig("condition.png")
