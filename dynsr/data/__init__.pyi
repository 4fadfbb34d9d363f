from .angles import RADIAN, is_in_degrees
from .catalogue import DEFINITIONS, find_definition
from .causes import Cause, DiagnosisSettings, diagnose, near_rows_leave_open, turns_back
from .codes import Missing
from .columns import Columns, load_columns, read_names_only
from .describing import describe, describe_table
from .description import Description, RunRows, TimeColumn
from .dose_tables import add_doses, load_with_doses
from .dosing import Dosing, clean_dose, clean_doses, cut_at_doses, split_volume
from .forcing import Forced, find_forced
from .holding import Hold, check_hold, choose_hold
from .kept import DATA, KeptData, digest, read_kept, write_kept
from .known_noise import KnownNoise
from .limits import Limits
from .motion_noise import MotionNoise, measure_motion_noise
from .name_parts import bracketed_unit
from .noise_model import (
    StateNoise,
    is_still,
    measurement_noise,
    robust_scale,
    scale_error,
    scale_of,
)
from .observation import at_own_rows, carry, told_rows, within_limits
from .oddities import Oddity, OddSettings, odd_states, odd_times, odd_values, one_step
from .reading import (
    column_units,
    in_formulas,
    in_unit,
    read_trajectories,
    sample_input,
    split_held_back,
    take_trajectories,
    with_drives,
    write_csv,
)
from .reading_sums import read_sums
from .samples import SCHEMES, Samples, join_samples, make_samples
from .slopes import FEWEST_SMOOTH, SMOOTHERS, SlopeSettings, choose_samples, smooth_column
from .smoothing import SmoothedTrajectory, estimate_noise, smooth
from .solver_rows import solver_errors
from .sums import MeasuredSum
from .system import PAPER_SYSTEMS, SYSTEMS, System, find_system
from .temporary import is_part, open_part, own_folder, remove_stale
from .times import check_time_unit
from .trajectory import FEWEST_ROWS, Trajectory, columns_of, decide_hold
from .unseen_steps import (
    UnseenSteps,
    UnseenStepSettings,
    cut_at_unseen_steps,
    find_steps,
    find_unseen_steps,
)
from .velocity import add_velocities, choose_second_samples
from .weak import weak_form
from .windows import Window, WindowSettings, choose_windows, cut_to_windows
from .writing import (
    check_new,
    check_replaceable,
    is_own_page,
    write_bytes,
    write_new,
    write_own,
    write_page,
    write_text,
)

__all__ = [
    "DATA",
    "DEFINITIONS",
    "FEWEST_ROWS",
    "FEWEST_SMOOTH",
    "PAPER_SYSTEMS",
    "RADIAN",
    "SCHEMES",
    "SMOOTHERS",
    "SYSTEMS",
    "Cause",
    "Columns",
    "Description",
    "DiagnosisSettings",
    "Dosing",
    "Forced",
    "Hold",
    "KeptData",
    "KnownNoise",
    "Limits",
    "MeasuredSum",
    "Missing",
    "MotionNoise",
    "OddSettings",
    "Oddity",
    "RunRows",
    "Samples",
    "SlopeSettings",
    "SmoothedTrajectory",
    "StateNoise",
    "System",
    "TimeColumn",
    "Trajectory",
    "UnseenStepSettings",
    "UnseenSteps",
    "Window",
    "WindowSettings",
    "add_doses",
    "add_velocities",
    "at_own_rows",
    "bracketed_unit",
    "carry",
    "check_hold",
    "check_new",
    "check_replaceable",
    "check_time_unit",
    "choose_hold",
    "choose_samples",
    "choose_second_samples",
    "choose_windows",
    "clean_dose",
    "clean_doses",
    "column_units",
    "columns_of",
    "cut_at_doses",
    "cut_at_unseen_steps",
    "cut_to_windows",
    "decide_hold",
    "describe",
    "describe_table",
    "diagnose",
    "digest",
    "estimate_noise",
    "find_definition",
    "find_forced",
    "find_steps",
    "find_system",
    "find_unseen_steps",
    "in_formulas",
    "in_unit",
    "is_in_degrees",
    "is_own_page",
    "is_part",
    "is_still",
    "join_samples",
    "load_columns",
    "load_with_doses",
    "make_samples",
    "measure_motion_noise",
    "measurement_noise",
    "near_rows_leave_open",
    "odd_states",
    "odd_times",
    "odd_values",
    "one_step",
    "open_part",
    "own_folder",
    "read_kept",
    "read_names_only",
    "read_sums",
    "read_trajectories",
    "remove_stale",
    "robust_scale",
    "sample_input",
    "scale_error",
    "scale_of",
    "smooth",
    "smooth_column",
    "solver_errors",
    "split_held_back",
    "split_volume",
    "take_trajectories",
    "told_rows",
    "turns_back",
    "weak_form",
    "with_drives",
    "within_limits",
    "write_bytes",
    "write_csv",
    "write_kept",
    "write_new",
    "write_own",
    "write_page",
    "write_text",
]
