"""Inputs that people report: each ends soon, in an answer or in one line of its cause."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from samples.real import real

LIMIT_S = 10
"""Of processor time, so that a busy machine makes no difference."""
HUNG_S = 250
"""Without an end, although nothing is computed."""
SUFFIXES = (".pcd", ".ply", ".xyz", ".bin", ".bag", ".db3", ".mcap", ".pcap", ".laz", ".las")
READ, REFUSED = 0, 1
EXPECTED: dict[str, tuple[int, str]] = {
    "06_pcd_lowercase_type/lower_bin.pcd": (READ, ""),
    "07_huge_finite_value/fltmax.bin": (READ, ""),
    "07_huge_finite_value/fltmax.pcd": (READ, ""),
    "08_ply_vertex_list/list.ply": (READ, ""),
    "11_ply_ascii_nan/count_first.xyz": (READ, ""),
    "11_ply_ascii_nan/nanind.ply": (READ, ""),
    "21_pc2_layouts/rowstep_total": (READ, ""),
    "22_same_stamps/two_lidars_two_frames": (REFUSED, "two sensors on one topic"),
    "24_bad_odometry/good_and_gps": (READ, r"note: /gps/odom: none of its \d+ poses is usable"),
    "24_bad_odometry/q0": (READ, "note: /odom: 2 of 11 poses dropped"),
    "24_bad_odometry/tf_q0": (READ, "note: /tf: 1 transforms of 'base_link' dropped"),
    "25_bag_hang/empty.mcap": (REFUSED, "empty file"),
    "25_bag_hang/no_clouds": (REFUSED, "no topic of scans; topics: /odom"),
    "25_bag_hang/text.bag": (REFUSED, "not a bag file"),
    "25_bag_hang/two_topics": (REFUSED, r"--topic: /a/points \(2\), /b/points \(2\)"),
    "26_point_times/fraction01": (READ, "note: point times run from 0 to 1: taken as fractions"),
    "26_point_times/us_u4": (READ, "note: point times span .* multiplied by 1000"),
    "30_mcap/cut.mcap": (REFUSED, "mcap recover"),
    "30_mcap/file_zstd_db3_nometa": (REFUSED, "ros2 bag reindex"),
    "33_stamp_names/ms": (READ, ""),
    "vlp32c_invalid_as_0.1.pcd": (READ, ""),
    "width0_points0_header.pcd": (READ, ""),
}
RUN = """
import contextlib, io, json, signal, sys
from segloc.tools.cli import main

def late(*_):
    raise SystemExit("too late")

signal.signal(signal.SIGPROF, late)
for words in json.load(sys.stdin):
    out, err, code = io.StringIO(), io.StringIO(), 0
    sys.argv = ["segloc", *words]
    signal.setitimer(signal.ITIMER_PROF, float(sys.argv.pop(1)))
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        except BaseException as error:
            code = f"{type(error).__name__}: {error}"
    signal.setitimer(signal.ITIMER_PROF, 0)
    print(json.dumps([code, out.getvalue(), err.getvalue()]), flush=True)
"""


def run_verbs(lines: list[list[str]], limit_s: int = LIMIT_S) -> list[tuple[Any, str, str]]:
    """Exit code, stdout and stderr of each command line, all of them in one process."""
    words = json.dumps([[str(limit_s), *line] for line in lines])
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        input=words,
        capture_output=True,
        text=True,
        timeout=HUNG_S,
        check=True,
    )
    return [tuple(json.loads(line)) for line in done.stdout.splitlines()]


def inputs() -> list[Path]:
    roots = [real("odd_inputs"), real("formats_found")]
    cases = [case for root in roots for case in sorted(root.iterdir())]
    found = []
    for case in cases:
        inner = sorted(case.iterdir()) if case.is_dir() else [case]
        found += [path for path in inner if path.is_dir() or path.suffix in SUFFIXES]
    return found


@pytest.mark.slow
def test_every_odd_input_ends_in_an_answer_or_one_line() -> None:
    paths = inputs()
    answers = run_verbs([["doctor", str(path)] for path in paths], 3 * LIMIT_S)
    faults = []
    for path, (code, out, err) in zip(paths, answers, strict=True):
        name = next((key for key in EXPECTED if str(path).endswith(f"/{key}")), None)
        lines = err.strip().splitlines()
        told = code in (0, 1) and "Traceback" not in err
        told &= code == 0 or len(lines) == 1 or bool(re.search("^problem: ", out, re.M))
        if name is not None:
            wanted, text = EXPECTED[name]
            # A scan by itself may still be of little use, which the doctor tells in its own words.
            read = re.search(r"\d scans?, ", out) and "cannot" not in out
            told &= read if wanted == READ else (code == 1 and err.startswith("segloc: "))
            told &= re.search(text, out + err) is not None
        if not told:
            faults.append(f"{path}: {code}: {out}{err}")
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize("words", [["info"], ["doctor", "--topic", "/nothing"]])
def test_the_installed_command_ends_where_there_are_two_topics(words: list[str]) -> None:
    """A fault with a ring of causes once kept the command from ending."""
    path = real("odd_inputs", "25_bag_hang", "two_topics")
    done = subprocess.run(
        [sys.executable, "-m", "segloc", words[0], str(path), *words[1:]],
        capture_output=True,
        text=True,
        timeout=HUNG_S,
        check=False,
    )
    assert done.returncode == 1
    assert re.fullmatch(r"segloc: .*/a/points \(2\), /b/points \(2\)\n", done.stderr)
