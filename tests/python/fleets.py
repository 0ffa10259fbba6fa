"""What tests of fleets run on: small logs, an object store of this machine, and processes of Dask."""

import itertools
import shutil
import threading
import time
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from urllib.request import Request, urlopen

import pyarrow.parquet as pq

from linkside import demo


def small_logs(folder, count, rows=200):
    """Make a robot and logs, pieces of the demonstration's, in a folder; the same for the same numbers."""
    (folder / "logs").mkdir()
    for name in ("robot.yaml", "robot.urdf"):
        shutil.copy(demo.FOLDER / name, folder)
    whole = pq.read_table(demo.FOLDER / "log.parquet")
    for i in range(count):
        pq.write_table(whole.slice(20 * i, rows), folder / "logs" / f"log{i:03}.parquet")
    return folder


def contents(folder):
    """Files of a folder by name, with what is in them."""
    return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


HEADERS = {
    "X-Test": "yes",
    "Content-Type": "application/octet-stream",
    "Authorization": "AWS4-HMAC-SHA256 Credential=test/20260101/us-east-1/s3/aws4_request, Signature=0",
}
"""Of a test's own requests, which are answered at once."""


class Busy:
    """A store that is slow, and too busy for one of a number of requests."""

    def __init__(self, store, every, delay):
        self.store, self.every, self.delay = store, every, delay
        self.requests, self.refused = itertools.count(1), 0
        self.endpoint = ""

    def put(self, name, content=None, method="PUT"):
        """Put an object there at once; or a bucket."""
        urlopen(Request(f"{self.endpoint}/{name}", content, HEADERS, method=method), timeout=20).close()

    def get(self, name):
        """What is in an object, at once."""
        with urlopen(Request(f"{self.endpoint}/{name}", headers=HEADERS), timeout=20) as answer:
            return answer.read()

    def __call__(self, environ, start_response):
        if "HTTP_X_TEST" in environ:
            return self.store(environ, start_response)
        time.sleep(self.delay)
        if next(self.requests) % self.every == 0:
            self.refused += 1
            status = HTTPStatus.SERVICE_UNAVAILABLE
            start_response(f"{status.value} {status.phrase}", [("Content-Length", "0")])
            return [b""]
        return self.store(environ, start_response)


@contextmanager
def object_store(monkeypatch, every, delay):
    """Serve S3 on the loopback interface, with a bucket ``fleet`` and nothing else; yields the server's application."""
    from fsspec.registry import registry
    from moto.server import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import make_server

    busy = Busy(DomainDispatcherApplication(create_backend_app), every, delay)
    server = make_server("127.0.0.1", 0, busy, threaded=True)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    busy.endpoint = f"http://127.0.0.1:{server.port}"
    if known := registry.get("s3"):
        known.clear_instance_cache()  # a process remembers stores, and those of an earlier server are gone
    for name, value in {
        "AWS_ENDPOINT_URL": busy.endpoint,
        "AWS_ALLOW_HTTP": "true",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    try:
        busy.put("moto-api/reset", method="POST")  # objects outlive a server in its process
        busy.put("fleet")
        yield busy
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
