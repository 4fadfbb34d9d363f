from .budget import Budget, TimeUp, Turn, finish_by, time_limit
from .display import LiveLines, NotebookProgress, TerminalProgress, clock, in_notebook, say_left
from .garbage import let_garbage_wait
from .interrupts import heard_again, interrupt_again, is_repeated, signal_again
from .pool import Task, check_jobs, check_seed, run_tasks, spread
from .progress import Step, Watch, best_equation
from .store import (
    MANIFEST,
    FolderTaken,
    RecordError,
    RunFolder,
    checksum,
    fingerprint,
    from_plain,
    read_json,
    read_manifest,
    read_record,
    to_json,
    to_plain,
)

__all__ = [
    "MANIFEST",
    "Budget",
    "FolderTaken",
    "LiveLines",
    "NotebookProgress",
    "RecordError",
    "RunFolder",
    "Step",
    "Task",
    "TerminalProgress",
    "TimeUp",
    "Turn",
    "Watch",
    "best_equation",
    "check_jobs",
    "check_seed",
    "checksum",
    "clock",
    "fingerprint",
    "finish_by",
    "from_plain",
    "heard_again",
    "in_notebook",
    "interrupt_again",
    "is_repeated",
    "let_garbage_wait",
    "read_json",
    "read_manifest",
    "read_record",
    "run_tasks",
    "say_left",
    "signal_again",
    "spread",
    "time_limit",
    "to_json",
    "to_plain",
]
