from .auditing import AuditRow, audit
from .page import render_replication, write_results
from .protocol import BASES, PAPER_METHODS, is_of_paper, paper_method
from .records import MANIFEST, Record, RecordError, read_record
from .reference import SparseRecord, sparse_records, trajectory_record
from .replication import PAPER_NAMES, replicate
from .results import table_1

__all__ = [
    "AuditRow",
    "BASES",
    "MANIFEST",
    "PAPER_METHODS",
    "PAPER_NAMES",
    "Record",
    "RecordError",
    "SparseRecord",
    "audit",
    "is_of_paper",
    "paper_method",
    "read_record",
    "render_replication",
    "replicate",
    "sparse_records",
    "table_1",
    "trajectory_record",
    "write_results",
]
