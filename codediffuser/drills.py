"""What drills share that kill a verb at some moment and look what it leaves."""

from __future__ import annotations

import subprocess
import sys


def start_verb(*words: str) -> subprocess.Popen[bytes]:
    """Start `codediffuser WORDS` in a process of its own, without its output."""
    return subprocess.Popen(
        [sys.executable, "-m", "codediffuser.cli", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def kill_after(process: subprocess.Popen[bytes], seconds: float) -> bool:
    """Give a process that many seconds to end, then end it by SIGKILL.

    Returns:
        Whether it was still at work and got the signal.
    """
    try:
        process.wait(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True
    return False
