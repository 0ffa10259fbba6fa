"""CSV as other programs write it gives the same recording, or a line that says what is expected."""

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from linkside import Log, LogError, Robot, demo

ROBOT = Robot.load(demo.ROBOT)
TABLE = pq.read_table(demo.LOG).to_pandas()[:200]
TEXT = TABLE.to_csv(index=False)
HEAD, *ROWS = TEXT.splitlines()

FILES = {
    "semicolon": TEXT.replace(",", ";").encode(),
    "excel": TABLE.to_csv(index=False, sep=";", decimal=",").encode("utf-8-sig"),
    "excel with sep": b"sep=;\r\n" + TABLE.to_csv(index=False, sep=";", lineterminator="\r\n").encode(),
    "tab": TEXT.replace(",", "\t").encode(),
    "tab, decimal comma": TABLE.to_csv(index=False, sep="\t", decimal=",").encode(),
    "blanks": TEXT.replace(",", ", ").encode(),
    "comments": b"# logger 1.2\n% of today\n\n" + TEXT.encode(),
    "header in a comment": ("# " + TEXT).encode(),
    "byte order mark": TEXT.encode("utf-8-sig"),
    "utf-16": TEXT.encode("utf-16"),
    "quoted": (",".join(f'"{name}"' for name in HEAD.split(",")) + "\n" + "\n".join(ROWS)).encode(),
    "latin-1": (HEAD + ",temp [°C]\n" + "\n".join(row + ",20" for row in ROWS)).encode("latin-1"),
}


@pytest.mark.parametrize("what", FILES)
def test_the_same_recording_however_it_is_written(what, tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(FILES[what])
    expected = Log.from_table(TABLE, ROBOT)
    whole = Log.read(path, ROBOT)
    pieces = list(Log.stream(path, ROBOT, rows=70))
    for signal in ("t", "theta", "dtheta", "tau", "acceleration", "ddqref"):
        np.testing.assert_array_equal(getattr(whole, signal), getattr(expected, signal))
        streamed = np.concatenate([getattr(piece, signal) for piece in pieces])
        np.testing.assert_array_equal(streamed, getattr(expected, signal))


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (TEXT.replace(",", " ").encode(), "columns separated by blanks"),
        (TEXT.encode("utf-16")[2:], "UTF-16 without a byte order mark"),
        (b"", "no header"),
        (
            ("# c\n" + HEAD + "\n" + ROWS[0] + "\n" + ROWS[1] + ",20\n").encode(),
            "row 1 has 41 columns where the header",
        ),
        (TEXT.replace(ROWS[5].split(",")[1], "1.2.3", 1).encode(), "is '1.2.3' at row"),
        (",".join(f"c{i}" for i in range(10_001)).encode() + b"\n", "at most 10000 columns"),
    ],
)
def test_what_cannot_be_read_is_refused_in_words(raw, words, tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(raw)
    with pytest.raises(LogError, match=words) as refused:
        Log.read(path, ROBOT)
    assert len(str(refused.value)) <= 500


def test_time_as_the_index_and_sparse_columns_are_columns_like_others():
    expected = Log.from_table(TABLE, ROBOT)
    indexed = Log.from_table(TABLE.set_index("t"), ROBOT)
    sparse = Log.from_table(TABLE.assign(theta_a1=pd.arrays.SparseArray(TABLE.theta_a1)), ROBOT)
    for log in (indexed, sparse):
        np.testing.assert_array_equal(log.t, expected.t)
        np.testing.assert_array_equal(log.theta, expected.theta)
