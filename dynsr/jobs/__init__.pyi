from .pool import Task, check_jobs, run_tasks, spread
from .progress import Step, Watch, best_equation
from .store import (
    MANIFEST,
    FolderTaken,
    RunFolder,
    fingerprint,
    from_plain,
    read_manifest,
    read_record,
    to_plain,
    write_bytes,
    write_json,
    write_text,
)

__all__ = [
    "MANIFEST",
    "FolderTaken",
    "RunFolder",
    "Step",
    "Task",
    "Watch",
    "best_equation",
    "check_jobs",
    "fingerprint",
    "from_plain",
    "read_manifest",
    "read_record",
    "run_tasks",
    "spread",
    "to_plain",
    "write_bytes",
    "write_json",
    "write_text",
]
