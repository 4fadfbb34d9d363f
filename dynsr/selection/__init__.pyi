from .approximations import Approximation, ApproximationSettings, MeasuredRuns, find_approximations
from .changes import prune
from .comparison import (
    ComparisonSettings,
    SystemComparison,
    SystemFit,
    may_be_exact,
    most_of_noise,
    noise_shown,
)
from .conservation import conserve
from .evidence import Evidence
from .first_look import Look, look, look_around
from .hidden import (
    HIDDEN,
    Coupling,
    HiddenFit,
    HiddenSettings,
    best_alone,
    different_laws,
    find_hidden,
    find_without,
    first_curve,
    law_of,
)
from .permuted import families
from .pick import (
    Pick,
    RankedCandidate,
    SelectionSettings,
    explains_all,
    forecast_error,
    lead_with,
    pick_equation,
    rank_by_length,
    trivial_candidates,
)
from .propose import term_bits
from .relations import VANISHES, is_left_open
from .shapes import bodies_of
from .stochastic import (
    STOCHASTIC_SEARCH,
    StochasticFound,
    StochasticSearch,
    StochasticSearchSettings,
)
from .subsets import Subset, best_subsets
from .systems import (
    Compared,
    SystemChoice,
    best_so_far,
    compare_systems,
    explore,
    follow_anything,
)
from .terms import move_inside, products, weighted_sum

__all__ = [
    "HIDDEN",
    "STOCHASTIC_SEARCH",
    "VANISHES",
    "Approximation",
    "ApproximationSettings",
    "Compared",
    "ComparisonSettings",
    "Coupling",
    "Evidence",
    "HiddenFit",
    "HiddenSettings",
    "Look",
    "MeasuredRuns",
    "Pick",
    "RankedCandidate",
    "SelectionSettings",
    "StochasticFound",
    "StochasticSearch",
    "StochasticSearchSettings",
    "Subset",
    "SystemChoice",
    "SystemComparison",
    "SystemFit",
    "best_alone",
    "best_so_far",
    "best_subsets",
    "bodies_of",
    "compare_systems",
    "conserve",
    "different_laws",
    "explains_all",
    "explore",
    "families",
    "find_approximations",
    "find_hidden",
    "find_without",
    "first_curve",
    "follow_anything",
    "forecast_error",
    "is_left_open",
    "law_of",
    "lead_with",
    "look",
    "look_around",
    "may_be_exact",
    "most_of_noise",
    "move_inside",
    "noise_shown",
    "pick_equation",
    "products",
    "prune",
    "rank_by_length",
    "term_bits",
    "trivial_candidates",
    "weighted_sum",
]
