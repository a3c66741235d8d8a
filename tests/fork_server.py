"""Children of the package as forks of a process that has their imports behind it: an import takes a second for each.

`popen` stands in for that of `subprocess` where the command is Python with `-c`. A fork has streams,
variables, limits and an exit code of its own, as a process that starts from nothing; only the imports are shared.
"""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import sys
import threading
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from uuid import uuid4

from places import ROOT

SERVER = """
import gc, json, os, select, signal, socket, sys, traceback

gc.disable()

from contextlib import suppress

import mujoco, numpy
import gauge_envs.runs.batch, gauge_envs.tools.conformance, gauge_envs.tools.catalog.listing
try:
    from pxr import Ar, Sdf, Tf, Usd
except ImportError:
    pass

listener = socket.socket(fileno=int(sys.argv[1]))
alive, woken = os.pipe()
os.set_blocking(woken, False)
signal.signal(signal.SIGCHLD, lambda *_: None)
signal.set_wakeup_fd(woken)
waiting, task = {}, None
gc.freeze()
gc.enable()
while task is None:
    ready = select.select([0, listener, alive], [], [])[0]
    if 0 in ready:
        sys.exit()  # Whoever started this process is gone.
    if alive in ready:
        os.read(alive, 4096)
    for pid in list(waiting):
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            # Who asked may be gone.
            with waiting.pop(pid) as client, suppress(BrokenPipeError):
                client.sendall(b"%d\\n" % os.waitstatus_to_exitcode(status))
    if listener not in ready:
        continue
    client = listener.accept()[0]
    message, fds, _, _ = socket.recv_fds(client, 1 << 22, 3)
    while not message.endswith(b"\\n"):
        message += client.recv(1 << 22)
    pid = os.fork()
    if pid:
        os.setpgid(pid, pid)
        waiting[pid] = client
        client.sendall(b"%d\\n" % pid)
        for fd in fds:
            os.close(fd)
    else:
        os.setpgid(0, 0)
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for number, fd in enumerate(fds):
            os.dup2(fd, number)
            os.close(fd)
        for held in (listener, client, *waiting.values()):
            held.close()
        os.close(alive)
        os.close(woken)
        task = json.loads(message)
os.chdir(task["folder"])
os.environ.clear()
os.environ.update(task["environment"])
path = task["environment"].get("PYTHONPATH", "").split(os.pathsep)
sys.path[:] = [entry for entry in path if entry] + [entry for entry in sys.path if entry not in path]
sys.argv = ["-c", *task["arguments"]]
try:
    exec(task["code"], {"__name__": "__main__"})
    code = 0
except SystemExit as end:
    code = end.code or 0
    if not isinstance(code, int):
        print(code, file=sys.stderr)
        code = 1
except BaseException:
    traceback.print_exc()
    code = 1
sys.stdout.flush()
sys.stderr.flush()
# To tear the interpreter down would copy all its pages.
os._exit(code)
"""
"""What the server does."""


class Fork:
    """A child, with the members of `subprocess.Popen` that the package uses."""

    def __init__(self, client):
        self._replies = client.makefile("rb")
        self._lock = threading.Lock()
        self.pid = int(self._replies.readline())
        self.returncode = None
        self.stdin = None
        self.stdout = None

    def wait(self, timeout=None):
        with self._lock:
            if self.returncode is None:
                if not select.select([self._replies], [], [], timeout)[0]:
                    raise subprocess.TimeoutExpired("fork", timeout)
                self.returncode = int(self._replies.readline())
                self._replies.close()
        return self.returncode


@cache
def start():
    """Start the server of this process, and return it and where it listens."""
    address = f"\0gauge-forks-{os.getpid()}-{uuid4()}"  # Linux names such a socket without a file.
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(address)
    listener.listen()
    # Its standard input ends with this process.
    server = subprocess.Popen(
        [sys.executable, "-u", "-P", "-c", SERVER, str(listener.fileno())],
        stdin=subprocess.PIPE,
        pass_fds=[listener.fileno()],
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "OMP_NUM_THREADS": "1",
            "PXR_WORK_THREAD_LIMIT": "1",
        },
    )
    listener.close()
    return server, address


def stop():
    """End the server, if it runs."""
    if start.cache_info().currsize:
        start()[0].communicate()


def _forked(command, streams, env):
    python, *options = command
    code = options.index("-c")
    assert python == sys.executable and set(options[:code]) <= {"-u", "-P"}, command
    task = {
        "code": options[code + 1],
        "arguments": options[code + 2 :],
        "environment": dict(os.environ if env is None else env),
        "folder": str(Path.cwd()),
    }
    client = socket.socket(socket.AF_UNIX)
    client.connect(start()[1])
    message = json.dumps(task).encode() + b"\n"
    sent = socket.send_fds(client, [message], list(streams))
    client.sendall(message[sent:])
    with client:
        return Fork(client)


def popen(
    command,
    *,
    stdin,
    stdout,
    env,
    start_new_session,
):
    """Start a child with pipes to its standard input and from its standard output."""
    assert stdin == stdout == subprocess.PIPE and start_new_session
    (reads, writes), (reads_back, writes_back) = os.pipe(), os.pipe()
    fork = _forked(command, (reads, writes_back, 2), env)
    os.close(reads)
    os.close(writes_back)
    fork.stdin, fork.stdout = os.fdopen(writes, "wb"), os.fdopen(reads_back, "rb")
    return fork


STAND_IN = SimpleNamespace(**{**vars(subprocess), "Popen": popen})
"""What takes the place of the module `subprocess` in a module that starts children."""
