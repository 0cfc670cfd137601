r"""Tractions under the contacts of a layered body: uniform pressure, and what a rigid disc can call forth.

Each traction is one of the components z (normal, outward), + or - (:math:`t_x\pm it_y`, none without friction), of
azimuthal order m, with the transform :math:`(-i)^{|m|}g(k)e^{im\varphi}`, g a ball :math:`j_{|m|+2n}(ka)` of
:mod:`forearm_fem.layered.hankel`: the span of :math:`x^{|m|}(1-x^2)^{n-1/2}e^{im\theta}`, which has the root
singularity at the rim. A bonded disc on a compressible body has :math:`(1-x^2)^{-1/2\pm i\epsilon}` instead
(Mossakovskii 1954; Spence 1968), which the series nears algebraically. Where a sheet on the skin resists, it carries
line forces on the rim, and a ring joins the balls.

Only the first, z of order 0 and n = 0, has a net force; it belongs to the port of the disc.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .hankel import Radial
from .kernel import Surface

Contact = Literal["pressure", "bonded", "frictionless"]
Component = Literal["z", "+", "-"]
_BESIDE = 6  # terms at most, less two per order, of what answers neighbours


@dataclass(frozen=True)
class Disc:
    """A disc on the surface, centre (x, y) and radius [m]; radius 0 is a point.

    ``contact``: uniform ``pressure`` (its displacement is the mean over it), or a rigid disc that moves along its
    normal only, ``bonded`` or ``frictionless``, as the finite elements have them (:mod:`forearm_fem.ports`).
    """

    x: float
    y: float
    radius: float = 0.0
    contact: Contact = "pressure"

    @property
    def rigid(self) -> bool:
        """Whether the skin under it moves as one."""
        return self.contact != "pressure"


@dataclass(frozen=True)
class Traction:
    """One traction: ``component``, azimuthal order ``m``, transform; the ``order`` of the whole vector that it is part
    of, and whether it is the ``last`` of its series."""

    component: Component
    m: int
    radial: Radial
    order: int = 0
    last: bool = False


def port_traction(disc: Disc) -> Traction:
    """The traction with a unit net force."""
    kind: Literal["ball", "mean", "point"] = "ball" if disc.rigid else "mean" if disc.radius > 0 else "point"
    return Traction("z", 0, Radial(kind, disc.radius))


def inner_tractions(disc: Disc, surface: Surface, terms: int, orders: int) -> list[Traction]:
    """Tractions without net force under a rigid disc, ``terms`` of the axisymmetric ones.

    Order l of the whole vector has m = l of the normal, l + 1 and l - 1 of the tangential components; |l| goes up to
    ``orders``, each order with two terms less than six, at least one. Without neighbours l = 0 is all there is.
    """
    components: tuple[Component, ...] = ("z", "+", "-") if disc.contact == "bonded" else ("z",)
    out: list[Traction] = []
    for order in range(-orders, orders + 1):
        count = terms if order == 0 else max(1, min(terms, _BESIDE) - 2 * abs(order))
        for component in components:
            m = order + {"z": 0, "+": 1, "-": -1}[component]
            balls = [Radial("ball", disc.radius, abs(m) + 2 * n) for n in range(count)]
            series = [Traction(component, m, g, abs(order), count > 1 and g is balls[-1]) for g in balls]
            out += series[1:] if (component, m) == ("z", 0) else series
            if surface.tension > 0 if component == "z" else surface.sheet:  # a sheet carries line forces there
                out.append(Traction(component, m, Radial("ring", disc.radius, abs(m)), abs(order)))
    return out
