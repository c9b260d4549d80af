"""Projective models: line and sample as quotients that share one denominator."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

from termsel.core.options import Option
from termsel.data.monomials import Exponents, graded_exponents
from termsel.models.quotient import MonomialModel

WEIGHTED = Option(
    "weighted", False, "Divide the equations by the denominators and iterate, to the least squares "
    "of distances in the image: each fit, and with control points each selection that a search "
    "judges by selection points.", bool)


class Projective(MonomialModel):
    """A quotient of forms in the same monomials, with one denominator for both axes."""

    declared_options: ClassVar[tuple[Option, ...]] = (WEIGHTED,)

    @property
    def divides(self) -> str:
        """One denominator."""
        return "shared"

    @property
    def weighted(self) -> bool:
        """Whether adjustments are iterated, of points too."""
        return bool(self.options["weighted"])

    @property
    def first_terms(self) -> None:
        """None: iterations begin at the linear solution, as an oblique view is far from affine."""
        return None


class Projective2D(Projective):
    """2D projective transformation: line and sample linear in X and Y over one denominator.

    8 terms. It maps plane to plane, as a frame camera maps flat ground.

    References
    ----------
    Valadan Zoej et al. 2002, eq. 3. By a misprint, the numerator of y there repeats the
    coefficients of x.

    Examples
    --------
    >>> import termsel
    >>> len(termsel.Projective2D().terms)
    8
    """

    name = "projective2d"
    uses_height = False

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of 1, X, Y."""
        return graded_exponents(1, 2)


class DLT2D(Projective):
    """Improved 2D-DLT: a DLT whose heights are a function of X and Y, over one denominator.

    The DLT has numerators and a denominator linear in X, Y, Z. With Z = d0 + d1 X + d2 Y + d3
    XY it becomes

        (a3 + a0 X + a1 Y + a2 XY) / (1 + c0 X + c1 Y + c2 XY)

    for the line, likewise with b for the sample: 11 terms, which absorb the four d. The d are
    no constraint: any 11 values arise, for instance from Z = XY.

    With a plane, Z = d0 + d1 X + d2 Y, the same substitution gives a quotient of linear forms,
    8 terms. For any plane this is `projective2d`, as a projective transformation takes up a
    tilted plane. The DLT adds XY alone to it.

    References
    ----------
    Valadan Zoej et al. 2002, eq. 4 (plane) and eq. 5 (with XY).

    Examples
    --------
    >>> import termsel
    >>> len(termsel.DLT2D().terms)
    11
    """

    name = "dlt2d"
    uses_height = False
    declared_options = (
        WEIGHTED,
        Option("relief", "xy", "Heights as a function of X and Y: with the term d3 XY; or a plane, "
               "which makes the model projective2d.", choices=("xy", "plane")),)

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of 1, X, Y and, unless the relief is a plane, XY."""
        # 1, X, Y for numerators and, without the constant, the denominator.
        linear = graded_exponents(1, 2)
        return (*linear, (1, 1, 0)) if self.options["relief"] == "xy" else linear


class DLT3D(Projective):
    """Direct linear transformation: line and sample linear in X, Y, Z over one denominator.

    11 terms: the collinearity equations of a frame camera without constraints between them. The
    columns are those of `rfm` of order 1 with a shared denominator.

    References
    ----------
    Abdel-Aziz and Karara 1971; Valadan Zoej et al. 2002, eq. 4, first part.

    Examples
    --------
    >>> import termsel
    >>> termsel.DLT3D().terms[-3:]
    ('den:X', 'den:Y', 'den:Z')
    """

    name = "dlt3d"

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of 1, X, Y, Z."""
        return graded_exponents(1, 3)
