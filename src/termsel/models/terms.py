"""Terms: what a column of a model is, and its name."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import lru_cache

from termsel.data.monomials import Exponent, monomial_name

AXES = ("line", "sample", "both")
"""Image axes a term may act on, in the order of the codes LINE, SAMPLE and BOTH."""

_CODES = {"numerator": "num", "denominator": "den"}
_PARTS = {code: part for part, code in _CODES.items()}
_TERM_NAME = re.compile(r"(?:(line|sample)\.)?(?:([^:]+):)?(.*)", re.DOTALL)
_POWER = r"({}(?:[2-9]|[1-9][0-9]+)?)?"
_MONOMIAL = re.compile("".join(map(_POWER.format, "XYZ")))


@dataclass(frozen=True)
class Term:
    """A term of a model. Its text is the name that files and options use.

    Parameters
    ----------
    axis : {"line", "sample", "both"}
        Image axis it acts on.
    part : str
        "numerator" or "denominator"; a model that is no quotient may have a word of its own, or
        none.
    exponents : tuple of 3 int, or str
        Exponents of X, Y and Z of a monomial; or the label of any other column, such as "3". A
        label that reads as a monomial becomes one.

    Raises
    ------
    ValueError
        For another axis, or exponents that are not three whole numbers of at least 0.

    Examples
    --------
    >>> from termsel import Term
    >>> str(Term("line", "numerator", (2, 1, 0)))
    'line.num:X2Y'
    >>> Term.parse("den:Z")
    Term(axis='both', part='denominator', exponents=(0, 0, 1))
    """

    axis: str
    part: str
    exponents: Exponent | str

    def __post_init__(self) -> None:
        """Turn a label such as "X2Y" into powers.

        Raises ValueError, and not TermselError, as terms are made by programs.
        """
        if self.axis not in AXES:
            raise ValueError(f"axis {self.axis!r} of a term is not one of {', '.join(AXES)}")
        if isinstance(self.exponents, str):
            label = self.exponents
            powers = _MONOMIAL.fullmatch(label)
            # "1" is the monomial whose powers are all 0; any other label without powers stays.
            if label == "1":
                object.__setattr__(self, "exponents", (0, 0, 0))
            elif label and powers is not None:
                object.__setattr__(self, "exponents", tuple(
                    int(power[1:] or 1) if power else 0 for power in powers.groups()))
        elif len(self.exponents) != 3 or min(self.exponents) < 0:
            raise ValueError(f"exponents {self.exponents} of a term are not three numbers >= 0: "
                             "give those of X, Y and Z, such as (1, 0, 0)")

    @staticmethod
    def parse(text: str) -> Term:
        """Return the term that has a name; its text is that name again.

        Parameters
        ----------
        text : str
            Such as "line.num:X2Y". Where a plugin names terms in a way of its own, all that is
            not an axis or a part is the label.
        """
        return _parse_term(text)

    def __str__(self) -> str:
        axis = "" if self.axis == "both" else f"{self.axis}."
        part = f"{_CODES.get(self.part, self.part)}:" if self.part else ""
        return f"{axis}{part}{self.column}"

    @property
    def column(self) -> str:
        """The monomial, such as "X2Y", "1" for the constant; or the label."""
        exponents = self.exponents
        return exponents if isinstance(exponents, str) else monomial_name(exponents)

    @property
    def order(self) -> int:
        """Total degree of the monomial; 0 for a label."""
        return 0 if isinstance(self.exponents, str) else sum(self.exponents)

    @property
    def has_height(self) -> bool:
        """False for a monomial without Z; a label may stand for anything."""
        return isinstance(self.exponents, str) or self.exponents[2] > 0

    @property
    def is_denominator(self) -> bool:
        """True for a term of a denominator."""
        return self.part == "denominator"

    @property
    def shared(self) -> Term:
        """The term for both axes: line.num:X and sample.num:X share num:X."""
        return replace(self, axis="both")

    @property
    def parents(self) -> tuple[Term, ...]:
        """The monomials of one power less, in the same part; none of a label."""
        if isinstance(self.exponents, str):
            return ()
        x, y, z = self.exponents
        # X2Y has the parents XY and X2: a hierarchical model has them, too.
        lower = ((x - 1, y, z), (x, y - 1, z), (x, y, z - 1))
        return tuple(replace(self, exponents=exponent) for exponent in lower if min(exponent) >= 0)


@lru_cache(maxsize=1024)  # a text is parsed each time that a model is made
def _parse_term(text: str) -> Term:
    """Return the term of a name such as "line.num:X2Y"; other text is a label for both axes."""
    match = _TERM_NAME.fullmatch(text)
    assert match is not None  # the pattern takes any text
    axis, kind, column = match.groups()
    return Term(axis or "both", _PARTS.get(kind, kind or ""), column)
