"""The paper's main claims: whether they hold in a run, and how much of that is chance."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from pushfric_core.paper.tables import Nested, tables

CLOSE = 0.3
"""A number agrees with the reference if it differs by at most this fraction."""

CLOSE_MU = 0.05
"""A friction coefficient of Table 3 agrees with the reference if it differs by at most this."""

SURE = 0.95
"""A claim counts as reproduced if it holds in this fraction of the seeds: 19 of 20."""

SHARE = 0.9
"""The spread of a claim contains this share of what runs with as many other seeds would find."""

DRAWN = 200
"""How often the seeds are drawn again."""


class Claim(NamedTuple):
    """A claim of the paper or of the reference.

    A claim about seeds says how often something held. Its spread is the exact (Clopper-Pearson) interval of the share of all
    seeds in which it holds. A claim about medians says how many of them are close enough. Its spread comes from drawing as many
    seeds again, with replacement (the bootstrap): the count lies within it in 90 % of the draws.
    """

    text: str
    asked: int | None  # None: nothing was asked
    held: int
    of: int
    spread: tuple[float, float]  # about seeds: shares in [0, 1]; about medians: counts
    about_seeds: bool

    @property
    def reproduced(self) -> bool:
        """Whether as many hold as were asked; if nothing was asked, whether all do."""
        return self.held >= (self.of if self.asked is None else self.asked)


def claims(seeds: Sequence[Mapping[str, Any]]) -> list[Claim]:
    """The claims, from the numbers of each seed (see `tables.tables`); the worst case of each claim about seeds counts."""
    rng = np.random.default_rng(0)
    medians = [{key: one[key] for key in ("table3", "table4", "table5")} for one in seeds]
    again = [tables([medians[index] for index in rng.integers(len(seeds), size=len(seeds))]) for _ in range(DRAWN)]
    found = tables(seeds)

    def worst(text: str, leaves: Sequence[Nested]) -> Claim:
        leaf = min(leaves, key=lambda one: one["held"] / one["of"])
        held, of = leaf["held"], leaf["of"]
        interval = stats.binomtest(held, of).proportion_ci(SHARE, "exact")
        return Claim(text, int(np.ceil(SURE * of)), held, of, (float(interval.low), float(interval.high)), True)

    def near(text: str, close: Callable[[Nested], list[bool]], asked: bool = True) -> Claim:
        all_close = close(found)
        counts = [sum(close(draw)) for draw in again]
        low, high = np.quantile(counts, ((1 - SHARE) / 2, (1 + SHARE) / 2), method="inverted_cdf").tolist()
        of = len(all_close)
        return Claim(text, of if asked else None, sum(all_close), of, (low, high), False)

    return [
        worst(
            "the right one of three look-alikes (Tables 4 and 5, each grid of 9 points and more)",
            [found[table][f"grid_{size}"]["correct"] for table in ("table4", "table5") for size in (9, 15, 24)],
        ),
        near(f"ratios of Tables 4 and 5 within {100 * CLOSE:.0f} % of the reference", lambda one: _agreeing(ratios(one))),
        near(
            f"the same within {100 * CLOSE:.0f} % of the paper",
            lambda one: [abs(leaf["median"] / leaf["paper"] - 1) <= CLOSE for leaf in ratios(one)],
            asked=False,
        ),
        worst(
            "the four feet found among 15 points (Figure 5, each object)",
            [figure["corners_are_top_four"] for figure in found["figure5"].values()],
        ),
        worst(
            "the true orientation (Figures 9 and 10, each half-width)",
            [leaf["correct"] for key in ("figure9", "figure10") for case in found[key].values() for leaf in case.values()],
        ),
        near(
            f"mu_c of wood_rect4 and the flat objects within {CLOSE_MU} of the reference (Table 3)",
            lambda one: _agreeing(
                [
                    leaf
                    for name in ("delrin_rect_center", "delrin_rect_right", "wood_rect4")
                    for leaf in one["table3"][name].values()
                ],
                CLOSE_MU,
            ),
        ),
    ]


def agrees(leaf: Nested, absolute: float | None = None) -> bool | None:
    """Whether a number is close enough to the reference; None if the reference has no such number.

    Args:
        leaf: of tables.json.
        absolute: largest difference allowed; None: the fraction `CLOSE` of the reference.
    """
    if "held" in leaf:
        return bool(leaf["held"] >= SURE * leaf["of"])
    if "reference" not in leaf:
        return None
    allowed = CLOSE * abs(leaf["reference"]) if absolute is None else absolute
    return bool(abs(leaf["median"] - leaf["reference"]) <= allowed)


def ratios(summary: Nested) -> list[Nested]:
    """The ratios of the wrong hypotheses of Tables 4 and 5, on grids of 9 points and more."""
    return [
        leaf
        for table, truth in (("table4", "center"), ("table5", "right"))
        for grid in ("grid_9", "grid_15", "grid_24")
        for key, leaf in summary[table][grid].items()
        if key.startswith("ratio") and key != f"ratio_{truth}"
    ]


def _agreeing(leaves: Sequence[Nested], absolute: float | None = None) -> list[bool]:
    return [bool(agrees(leaf, absolute)) for leaf in leaves if "reference" in leaf]
