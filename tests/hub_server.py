"""A hub on this machine, for uploads: repositories, branches, tags, pull requests, commits and large files, in memory.

It speaks as much of the hub's HTTP protocol as `huggingface_hub` needs without Xet (`HF_HUB_DISABLE_XET=1`).
"""

import base64
import hashlib
import json
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

TOKEN, USER = "hf_secret", "me"
LARGE = (".parquet", ".mp4", ".png")  # what the hub keeps as large files in a dataset, more or less
EPOCH = "2026-01-01T00:00:00.000Z"


class Refused(Exception):
    """An answer other than 200."""

    def __init__(self, status: int, message: str, code: str | None = None, **more: str) -> None:
        super().__init__(message)
        self.status, self.code, self.body = status, code, {"error": message, **more}


@dataclass
class Repository:
    """A repository. Revisions are branches, tags and `refs/pr/N`; each has a commit, each commit all its files."""

    private: bool = False
    commits: dict[str, dict[str, bytes]] = field(default_factory=lambda: {"0" * 40: {".gitattributes": b"*.bin"}})
    branches: dict[str, str] = field(default_factory=lambda: {"main": "0" * 40})
    tags: dict[str, str] = field(default_factory=dict)
    requests: list[dict[str, Any]] = field(default_factory=list)
    titles: list[str] = field(default_factory=list)

    def oid(self, revision: str) -> str:
        for known in (self.branches, self.tags):
            if revision in known:
                return known[revision]
        if revision in self.commits:
            return revision
        raise Refused(404, f"Invalid rev id: {revision}", "RevisionNotFound")

    def files(self, revision: str = "main") -> dict[str, bytes]:
        return self.commits[self.oid(revision)]


class Hub:
    """Context manager that serves at `url`.

    Attributes:
        repositories: by `<user>/<name>`.
        large: content of large files that have arrived, by their SHA-256.
        log: requests, as `METHOD /path`.
        refuse: statuses to answer with, by a pattern for what is logged.
        before_storing: called with the number of large files that have arrived before another is taken.
    """

    def __init__(self) -> None:
        self.repositories: dict[str, Repository] = {}
        self.large: dict[str, bytes] = {}
        self.log: list[str] = []
        self.refuse: dict[str, int] = {}
        self.before_storing: Callable[[int], None] = lambda _: None
        self.lock = threading.Lock()
        handler = type("BoundHandler", (_Handler,), {"hub": self})
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_port}"

    def __enter__(self) -> "Hub":
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def environment(self, home: object) -> dict[str, str]:
        """For a process that shall know no other hub; `home` is its cache."""
        return {"HF_ENDPOINT": self.url, "HF_TOKEN": TOKEN, "HF_HUB_DISABLE_XET": "1", "HF_HOME": str(home)}

    # -- what there is to ask; each takes the body and the query -------------------------------------------------------

    def validate(self, body: Any, query: dict) -> Any:
        return {"warnings": [], "errors": []}

    def whoami(self, body: Any, query: dict) -> Any:
        return {"type": "user", "name": USER, "orgs": []}

    def create(self, body: Any, query: dict) -> Any:
        name = f"{body.get('organization') or USER}/{body['name']}"
        if body["type"] != "dataset":
            raise Refused(400, f"this hub has datasets, not a {body['type']}")
        if not name.startswith(f"{USER}/"):
            raise Refused(
                403, f"You don't have the rights to create a dataset under the namespace {name.split('/')[0]}"
            )
        if name in self.repositories:
            raise Refused(409, "You already created this dataset repo", url=f"{self.url}/datasets/{name}")
        self.repositories[name] = Repository(body.get("visibility") == "private" or bool(body.get("private")))
        return {"url": f"{self.url}/datasets/{name}", "name": name}

    def info(self, body: Any, query: dict, repo: str, revision: str = "main") -> Any:
        repository = self._repository(repo)
        siblings = [{"rfilename": path} for path in repository.files(revision)]
        return {"id": repo, "sha": repository.oid(revision), "private": repository.private, "siblings": siblings}

    def tree(self, body: Any, query: dict, repo: str, revision: str) -> Any:
        files = self._repository(repo).files(revision)
        return [
            {"type": "file", "path": path, "size": len(data), "oid": _git_oid(data)} for path, data in files.items()
        ]

    def preupload(self, body: Any, query: dict, repo: str, revision: str) -> Any:
        files = self._repository(repo).files(revision)
        return {"files": [self._mode(file["path"], files.get(file["path"])) for file in body["files"]]}

    def _mode(self, path: str, there: bytes | None) -> dict[str, Any]:
        large = path.endswith(LARGE)
        oid = None if there is None else hashlib.sha256(there).hexdigest() if large else _git_oid(there)
        return {"path": path, "uploadMode": "lfs" if large else "regular", "shouldIgnore": False, "oid": oid}

    def batch(self, body: Any, query: dict, repo: str) -> Any:
        self._repository(repo)
        objects = []
        for wanted in body["objects"]:
            oid = wanted["oid"]
            if oid not in self.large:
                steps = {"upload": {"href": f"{self.url}/store/{oid}"}, "verify": {"href": f"{self.url}/verify/{oid}"}}
                wanted = {**wanted, "actions": steps}
            objects.append(wanted)
        return {"transfer": "basic", "objects": objects}

    def store(self, body: bytes, query: dict, oid: str) -> Any:
        self.before_storing(len(self.large))
        if hashlib.sha256(body).hexdigest() != oid:
            raise Refused(400, "the content is not what was announced")
        self.large[oid] = body
        return {}

    def verify(self, body: Any, query: dict, oid: str) -> Any:
        if len(self.large.get(oid, b"")) != body["size"] or body["oid"] != oid:
            raise Refused(400, "the size is not what was announced")
        return {}

    def commit(self, body: bytes, query: dict, repo: str, revision: str) -> Any:
        repository = self._repository(repo)
        repository.oid(revision)
        files, title = dict(repository.files(revision)), ""
        for line in body.splitlines():
            operation = json.loads(line)
            value = operation["value"]
            match operation["key"]:
                case "header":
                    title = value["summary"]
                case "file":
                    files[value["path"]] = base64.b64decode(value["content"])
                case "lfsFile":
                    if value["oid"] not in self.large:
                        raise Refused(400, f"{value['path']} was not uploaded")
                    files[value["path"]] = self.large[value["oid"]]
                case "deletedFile":
                    del files[value["path"]]
                case other:
                    raise Refused(400, f"unknown operation {other}")
        oid = hashlib.sha1(f"{len(repository.commits)}{revision}".encode()).hexdigest()
        repository.commits[oid], repository.branches[revision] = files, oid
        repository.titles.append(title)
        return {"success": True, "commitOid": oid, "commitUrl": f"{self.url}/datasets/{repo}/commit/{oid}"}

    def branch(self, body: Any, query: dict, repo: str, name: str) -> Any:
        repository = self._repository(repo)
        if name in repository.branches:
            raise Refused(409, f"Reference already exists: {name}")
        repository.branches[name] = repository.oid(body.get("startingPoint", "main"))
        return {}

    def tag(self, body: Any, query: dict, repo: str, revision: str) -> Any:
        repository = self._repository(repo)
        if body["tag"] in repository.tags:
            raise Refused(409, f"Tag already exists: {body['tag']}")
        repository.tags[body["tag"]] = repository.oid(revision)
        return {}

    def untag(self, body: Any, query: dict, repo: str, name: str) -> Any:
        if self._repository(repo).tags.pop(name, None) is None:
            raise Refused(404, f"Invalid rev id: {name}", "RevisionNotFound")
        return {}

    def discussions(self, body: Any, query: dict, repo: str) -> Any:
        found = [r for r in self._repository(repo).requests if r["author"]["name"] == query.get("author", [USER])[0]]
        return {"discussions": found, "count": len(found), "start": 0}

    def discuss(self, body: Any, query: dict, repo: str) -> Any:
        repository, number = self._repository(repo), len(self._repository(repo).requests) + 1
        request = {"num": number, "title": body["title"], "author": {"name": USER}, "createdAt": EPOCH}
        request |= {"status": "draft", "isPullRequest": body["pullRequest"], "repo": {"name": repo, "type": "dataset"}}
        repository.requests.append(request)
        repository.branches[f"refs/pr/{number}"] = repository.oid("main")
        return request

    def discussion(self, body: Any, query: dict, repo: str, number: str) -> Any:
        changes = {"base": "refs/heads/main", "mergeCommitId": None}
        return self._repository(repo).requests[int(number) - 1] | {
            "events": [],
            "filesWithConflicts": [],
            "changes": changes,
        }

    def _repository(self, name: str) -> Repository:
        if name not in self.repositories:
            raise Refused(404, "Repository not found", "RepoNotFound")
        return self.repositories[name]


_REPO, _REVISION = r"([^/]+/[^/]+?)", r"([^/]+)"
_ROUTES: list[tuple[str, Callable[..., Any]]] = [
    (r"POST /api/validate-yaml", Hub.validate),
    (r"GET /api/whoami-v2", Hub.whoami),
    (r"POST /api/repos/create", Hub.create),
    (rf"GET /api/datasets/{_REPO}", Hub.info),
    (rf"GET /api/datasets/{_REPO}/revision/{_REVISION}", Hub.info),
    (rf"GET /api/datasets/{_REPO}/tree/{_REVISION}", Hub.tree),
    (rf"POST /api/datasets/{_REPO}/preupload/{_REVISION}", Hub.preupload),
    (rf"POST /datasets/{_REPO}\.git/info/lfs/objects/batch", Hub.batch),
    (r"PUT /store/(\w+)", Hub.store),
    (r"POST /verify/(\w+)", Hub.verify),
    (rf"POST /api/datasets/{_REPO}/commit/{_REVISION}", Hub.commit),
    (rf"POST /api/datasets/{_REPO}/branch/{_REVISION}", Hub.branch),
    (rf"POST /api/datasets/{_REPO}/tag/{_REVISION}", Hub.tag),
    (rf"DELETE /api/datasets/{_REPO}/tag/{_REVISION}", Hub.untag),
    (rf"GET /api/datasets/{_REPO}/discussions", Hub.discussions),
    (rf"POST /api/datasets/{_REPO}/discussions", Hub.discuss),
    (rf"GET /api/datasets/{_REPO}/discussions/(\d+)", Hub.discussion),
]


class _Handler(BaseHTTPRequestHandler):
    hub: Hub
    protocol_version = "HTTP/1.1"

    def _answer(self) -> None:
        url = urlsplit(self.path)
        asked, content = f"{self.command} {url.path}", self._content()
        self.hub.log.append(asked)
        try:
            self._send(200, json.dumps(self._ask(asked, content, parse_qs(url.query))).encode())
        except Refused as refusal:
            code = {"X-Error-Code": refusal.code} if refusal.code else {}
            self._send(refusal.status, json.dumps(refusal.body).encode(), code)

    do_GET = do_POST = do_PUT = do_DELETE = _answer

    def _ask(self, asked: str, content: bytes, query: dict) -> Any:
        if not asked.startswith("PUT") and self.headers.get("authorization") != f"Bearer {TOKEN}":
            raise Refused(401, "Invalid username or password.")
        for pattern, status in self.hub.refuse.items():
            if re.search(pattern, asked):
                raise Refused(status, "refused by the test")
        for pattern, method in _ROUTES:
            if found := re.fullmatch(pattern, asked):
                raw = method in (Hub.store, Hub.commit)
                body = content if raw else json.loads(content or b"{}")
                if method is Hub.store:  # may wait
                    return method(self.hub, body, query, *found.groups())
                with self.hub.lock:
                    return method(self.hub, body, query, *map(unquote, found.groups()))
        raise Refused(404, f"this hub does not know {asked}")

    def _content(self) -> bytes:
        if self.headers.get("transfer-encoding") != "chunked":
            return self.rfile.read(int(self.headers.get("content-length", 0)))
        content = b""
        while size := int(self.rfile.readline(), 16):
            content += self.rfile.read(size)
            self.rfile.readline()
        self.rfile.readline()
        return content

    def _send(self, status: int, body: bytes, headers: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for name, value in {
            "Content-Type": "application/json",
            "Content-Length": str(len(body)),
            **(headers or {}),
        }.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        pass


def _git_oid(content: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()
