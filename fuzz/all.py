"""Run every target for a time, and print a table: processor time, executions, branches taken, and what went wrong.

    python fuzz/all.py --seconds 3600 [--jobs 2] [--built FOLDER] [TARGET ...]

Rust's targets are those that `build.sh` has built; Python's need atheris (``pip install atheris``). New inputs are kept
in `target/fuzz/<target>`, findings in `target/fuzz/findings`.
"""

import argparse
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RUST = re.findall(r'^    \("(\w+)",', (ROOT / "fuzz/src/lib.rs").read_text(), flags=re.MULTILINE)
PYTHON = re.findall(r"^        (\w+),$", (ROOT / "fuzz/python/targets.py").read_text(), flags=re.MULTILINE)
OPTIONS = ("-timeout=25", "-rss_limit_mb=3000", "-print_final_stats=1", "-max_len=8192")
WORK = ROOT / "target/fuzz"


def fuzz(target, seconds, built):
    """Run a target; gives a row of the table."""
    found, findings = WORK / target, WORK / "findings"
    found.mkdir(parents=True, exist_ok=True)
    findings.mkdir(exist_ok=True)
    command = [built / target] if target in RUST else [sys.executable, ROOT / "fuzz/python/run.py", target]
    folders = [found, ROOT / "fuzz/corpus" / target]
    told = [f"-max_total_time={seconds}", f"-artifact_prefix={findings}/{target}-"]
    log = WORK / f"{target}.log"
    with log.open("wb") as file:
        run = subprocess.Popen([*command, *OPTIONS, *told, *folders], stdout=file, stderr=file)
    _, status, used = os.wait4(run.pid, 0)  # the time of this run alone
    run.returncode = os.waitstatus_to_exitcode(status)
    said = log.read_text(errors="replace")
    stats = dict(re.findall(r"^stat::(\w+): +(\d+)$", said, flags=re.MULTILINE))
    paths = re.findall(r"cov: (\d+)", said)
    artifacts = re.findall(r"Test unit written to (\S+)", said)
    verdict = "none" if run.returncode == 0 else " ".join(artifacts) or f"exit status {run.returncode}"
    count = int(stats.get("number_of_executed_units", 0))
    return target, used.ru_utime + used.ru_stime, count, int(paths[-1]) if paths else 0, verdict


def main():
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=3600)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--built", type=Path, default=None, help="folder of the built targets")
    parser.add_argument("targets", nargs="*", default=[*RUST, *PYTHON])
    told = parser.parse_args()
    host = subprocess.run(["rustc", "--print", "host-tuple"], check=True, capture_output=True, text=True).stdout.strip()
    built = told.built or ROOT / "fuzz/target" / host / "release"
    print("| target | CPU time [s] | executions | branches | findings |\n| --- | --- | --- | --- | --- |", flush=True)
    clean = True
    with ThreadPoolExecutor(told.jobs) as pool:
        for row in pool.map(lambda one: fuzz(one, told.seconds, built), told.targets):
            target, used, count, paths, verdict = row
            print(f"| {target} | {used:.0f} | {count:,} | {paths} | {verdict} |", flush=True)
            clean &= verdict == "none"
    return 0 if clean else 1


if __name__ == "__main__":
    sys.exit(main())
