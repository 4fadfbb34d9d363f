from .batch import write_batch
from .discovery import (
    list_by_run,
    list_fixed_points,
    show_branches,
    show_flow,
    show_noise,
    write_report,
)
from .page import Picture, render_page, write_table
from .plots import (
    Panel,
    draw_branches,
    draw_by_run,
    draw_flow,
    draw_free,
    draw_panels,
    draw_profiles,
    draw_states,
    draw_suggestion,
    to_bytes,
)
from .tables import Formula, Spread, Table

__all__ = [
    "Formula",
    "Panel",
    "Picture",
    "Spread",
    "Table",
    "draw_branches",
    "draw_by_run",
    "draw_flow",
    "draw_free",
    "draw_panels",
    "draw_profiles",
    "draw_states",
    "draw_suggestion",
    "list_by_run",
    "list_fixed_points",
    "render_page",
    "show_branches",
    "show_flow",
    "show_noise",
    "to_bytes",
    "write_batch",
    "write_report",
    "write_table",
]
