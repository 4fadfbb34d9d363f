from .checkpoint import FolderTaken, Part, Record, RunFolder, fingerprint, run_parts
from .live import LiveFolder
from .store import write_bytes, write_json, write_text
from .watch import Running, Step, Watch

__all__ = [
    "FolderTaken",
    "LiveFolder",
    "Part",
    "Record",
    "RunFolder",
    "Running",
    "Step",
    "Watch",
    "fingerprint",
    "run_parts",
    "write_bytes",
    "write_json",
    "write_text",
]
