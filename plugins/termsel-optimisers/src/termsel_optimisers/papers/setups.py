"""Problems with the set-ups of papers: data, model, mask, solver, rates, stopping rule, criterion.

What a paper does not state is termsel's own; docs/explanation/papers.md lists it. All is
overridable.
"""

from __future__ import annotations

from termsel import Recipe
from termsel.toolkit.searches import (
    OF_BOTH,
    OF_TERMS,
    YAVARI,
    select_both,
    select_terms,
    with_defaults,
)

PATIENCE = 50
"""Generations without a gain after which a search has converged, where a paper states no number."""

# Table 2 of the paper, for its own GA and for the one without correlations alike.
AKHOUNDI_GA = {"population": 500, "mutation": 0.001, "survival": "children"}


# Each is what its paper states: no limit on terms where it has none, and no refinement after it.
PAPERS = (
    Recipe("valadan-zoej-2002", "Terms of a 2-D polynomial for each axis by a GA that crosses "
           "the two best, IKONOS with 63 control and 31 selection points.", select_terms,
           model="poly2d", model_options={"degree": 3, "powers": "each"},
           dataset="ikonos-hamedan-63-31", options=with_defaults(OF_TERMS, max_share=1.0),
           solver="ga", patience=PATIENCE, refined=False,
           solver_options={"ga": {"parents": "two-best", "survival": "children"}},
           source="Valadan Zoej et al. 2002, sections 2.1 and 3.2, table 1"),
    Recipe("zakaryaie-2015", "Terms of a 2-D polynomial for both axes by ICA, IKONOS with 35 "
           "control and 39 selection points.", select_terms,
           model="poly2d", model_options={"degree": 5}, dataset="ikonos-hamedan-35-39",
           options=with_defaults(OF_TERMS, mask="shared", max_share=1.0), solver="ica",
           # Their table 3 compares with the populations of Yavari et al. 2012.
           solver_options={"ica": {"population": 100, "imperialists": 0.1, "revolution": 0.1,
                                   "alpha": 0.08, "similarity": True},
                           "ga": {"population": 50, "survival": "children"},
                           "pso": {"population": 30}},
           patience=PATIENCE, refined=False, source="Zakaryaie Nejad et al. 2015, table 1"),
    Recipe("yavari-2018", "Control lines by GA under an RFM of 78 terms, then its terms by "
           "particle swarm.", select_both,
           model="rfm", dataset="ikonos-hamedan", control="lines",
           options=with_defaults(OF_BOTH, steps="features-first", then="pso", max_share=1.0,
                                 blunders="keep"),
           solver="ga", solver_options={"ga": {"survival": "children"}}, patience=PATIENCE,
           refined=False, source=YAVARI),
    Recipe("akhoundi-2020", "Terms of an RFM of 78 by a GA with a population guided by "
           "correlation, IKONOS with 24 control, 24 selection and 26 independent check points.",
           select_terms, model="rfm", dataset="ikonos-hamedan",
           options=with_defaults(OF_TERMS, max_share=1.0), solver="ga-correlation",
           solver_options={"ga": AKHOUNDI_GA, "ga-correlation": AKHOUNDI_GA}, patience=PATIENCE,
           refined=False, source="Akhoundi Khezrabad et al. 2020, tables 2, 3 and 7"),
)
