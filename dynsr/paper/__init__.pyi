from .auditing import AuditRow, audit
from .page import render_replication, write_results
from .protocol import (
    PAPER_NAMES,
    is_of_paper,
    paper_method,
    printed_loss,
    score_as_printed,
)
from .records import Record
from .reference import SparseRecord, sparse_records, trajectory_record
from .replication import replicate
from .results import loss_table, table_1

__all__ = [
    "PAPER_NAMES",
    "AuditRow",
    "Record",
    "SparseRecord",
    "audit",
    "is_of_paper",
    "loss_table",
    "paper_method",
    "printed_loss",
    "render_replication",
    "replicate",
    "score_as_printed",
    "sparse_records",
    "table_1",
    "trajectory_record",
    "write_results",
]
