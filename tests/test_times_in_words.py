"""Times as other languages, programs and zones write them."""

import numpy as np
import pytest

from dynsr.data import read_trajectories
from dynsr.data.times import read_times
from dynsr.errors import InputError


@pytest.mark.parametrize(
    ("first", "second", "apart"),
    [
        ("2024-03-30 00:00 CET", "2024-03-30 01:00 CET", 3600),
        ("2024-03-31 01:00 CET", "2024-03-31 03:00 CEST", 3600),
        ("2024-03-10 01:00 EST", "2024-03-10 03:30 EDT", 5400),
        ("Sat Mar 30 00:00:01 CET 2024", "Sat Mar 30 00:00:03 CET 2024", 2),
        ("2024/03/30-10:11:12.5", "2024/03/30-10:11:13.5", 1),
        ("0:00:01:500", "0:00:02:000", 0.5),
        ("1h 30m", "2h 0m", 1800),
        ("45m", "1h 5m", 1200),
        ("1m 2.5s", "1m 3s", 0.5),
        ("2024年3月30日", "2024年3月31日", 86400),
        ("30 mars 2024", "31 mars 2024", 86400),
        ("1 de enero de 2024", "1 de febrero de 2024", 31 * 86400),
        ("1 septiembre 2024", "2 septiembre 2024", 86400),
        ("30 giugno 2024", "1 luglio 2024", 86400),
        ("31 december 2023", "1 januari 2024", 86400),
    ],
)
def test_times_are_apart_as_a_calendar_has_them(first, second, apart):
    """Seconds between two of them, by hand."""
    found = read_times(np.array([first, second], dtype=object))
    assert found is not None
    assert found.seconds[1] - found.seconds[0] == pytest.approx(apart)


def test_the_first_cell_that_is_no_time_is_named(tmp_path):
    """Of clocks with one that has 60 minutes it is that one, not the first row."""
    path = tmp_path / "clock.csv"
    rows = "\n".join(f"00:{5 * k:02d}:00,{5 - k % 4}" for k in range(13))
    path.write_text(f"Time,x\n{rows}\n")
    with pytest.raises(InputError, match=r"'00:60:00' in row 13"):
        read_trajectories(path)
