"""The server of the page: on this machine alone, and for who knows the secret of the run.

Each request must have the secret in its path, this server in its Host, and no other origin than
this server. A path names a layer, a kind of output or a file of the page from a fixed list; no
request names a file of the disk.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import secrets
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from typing import Any

import numpy as np
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from termsel import TermselError
from termsel_app.layers import (
    box_of_tile,
    graticule_for_page,
    image_resolutions,
    image_tile,
    vectors_for_page,
    warped_tile,
)
from termsel_app.matching import can_match, propose_points, refine_point
from termsel_app.outputs import OUTPUTS, command_line, save
from termsel_app.rasters import TILE, encode_png
from termsel_app.session import Session, check_place_pairs

ADDRESS = "127.0.0.1"
LARGEST_BODY = 2**22
PAGE = {"app.js": "text/javascript", "panes.js": "text/javascript", "panel.js": "text/javascript",
        "server.js": "text/javascript", "style.css": "text/css", "vendor/ol.js": "text/javascript",
        "vendor/ol.css": "text/css"}
"""Files of the page, and what they are."""
# Threads that compute: a slow tile must not hold up the others.
_THREADS = 4
log = logging.getLogger(__name__)


class Pages:
    """The session, its secret and the pages that are open.

    Parameters
    ----------
    session : Session
        What the page shows and changes.
    port : int
        The port of `ADDRESS` at which the page is served.

    Attributes
    ----------
    secret : str
        What each request of an open page has to name.
    first : str
        What the address has that the browser is opened with; it is accepted once.
    box : tuple of float
        The area of the map, x min, y min, x max and y max.
    open : set of Events
        The pages that are open.
    """

    def __init__(self, session: Session, port: int) -> None:
        self.session = session
        self.secret = secrets.token_urlsafe(24)
        # Other users see the address on the command line of the browser: it works once only.
        self.first = secrets.token_urlsafe(24)
        self.port = port
        self.box = session.box()
        self.threads = ThreadPoolExecutor(_THREADS)
        self.open: set[Events] = set()

    @property
    def hosts(self) -> tuple[str, str]:
        """Values that the header Host of a request may have."""
        return (f"{ADDRESS}:{self.port}", f"localhost:{self.port}")

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://{ADDRESS}:{self.port}/{self.secret}/"

    @property
    def first_address(self) -> str:
        """The address that the browser is started with, which leads to the page once.

        Others on this machine may see with what a program was started.
        """
        return f"http://{ADDRESS}:{self.port}/{self.first}"

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message to all open pages; to be called in the thread of the server."""
        text = json.dumps(message)
        # `send` removes a page that has gone from the set, so a copy is iterated over.
        for events in tuple(self.open):
            events.send(text)


class Guarded(RequestHandler):
    """A request, refused in silence unless secret, Host and origin are right."""

    pages: Pages

    def initialize(self, pages: Pages) -> None:
        """Keep the pages, which have the session; Tornado calls it before each request."""
        self.pages = pages

    def set_default_headers(self) -> None:
        """Let the page load nothing from elsewhere, and nobody else show it or read it."""
        self.set_header("Server", "termsel")
        # What was measured may be secret: no copy stays in the browser.
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("Cross-Origin-Opener-Policy", "same-origin")

    def prepare(self) -> None:
        """Raise HTTPError 403 for a request without the secret or from elsewhere."""
        if not is_allowed(self):
            raise HTTPError(403)

    def write_error(self, status_code: int, **_: Any) -> None:
        """Answer with the status alone, so that a stranger learns nothing."""
        self.finish()

    def log_exception(self, *details: Any) -> None:
        """Log a fault without its request, which has the secret; log nothing of a refusal."""
        if not isinstance(details[1], HTTPError):
            log.error("A request of the page failed.", exc_info=details)

    @property
    def session(self) -> Session:
        """Session that the pages show."""
        return self.pages.session

    async def run_in_thread(self, task: Callable[..., Any], *arguments: Any) -> Any:
        """Return what a task returns for arguments, run in a thread so that the page stays usable.
        """
        return await IOLoop.current().run_in_executor(self.pages.threads, task, *arguments)


def is_allowed(handler: RequestHandler, expected: str | None = None) -> bool:
    """Return whether a request has the secret, names this server as Host, and is from its page.

    The secret, the first part of the path, is `expected`, by default that of the pages. A request
    without an origin counts as one of the page.
    """
    pages: Pages = handler.pages  # type: ignore[attr-defined]
    expected = expected or pages.secret
    # A website may send requests to this machine: only the secret in the address shows our page.
    secret = handler.path_args[0] if handler.path_args else ""
    origin = handler.request.headers.get("Origin")
    # The comparison takes constant time, so that the secret cannot be guessed letter by letter.
    # Another Host is a name that somebody lets lead here (DNS rebinding).
    return (hmac.compare_digest(str(secret).encode(), expected.encode())
            and handler.request.host in pages.hosts
            and (origin is None or origin in {f"http://{host}" for host in pages.hosts})
            and handler.request.headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin"))


class Page(Guarded):
    """The page, and the files that belong to it."""

    def get(self, secret: str, name: str) -> None:
        """Send a file of the page, index.html for ""; raises HTTPError 404 for any other file.

        Only files of a fixed list are sent. The page itself gets a policy by which the browser
        loads nothing but from this server and from those of images that the user named.
        """
        name = name or "index.html"
        # With a list of files, no path can lead out of a folder.
        if name != "index.html" and name not in PAGE:
            raise HTTPError(404)
        file = files("termsel_app").joinpath("page", *name.split("/"))
        if not file.is_file():
            raise HTTPError(404)
        self.set_header("Content-Type", f"{PAGE.get(name, 'text/html')}; charset=utf-8")
        if name == "index.html":
            session = self.session
            # The page may load images from the servers that the user named, and nothing else.
            origins = {_origin_of_tiles(tiles) for tiles in session.maps.tiles}
            if session.served is not None:
                origins.add(session.served.origin)
            servers = " ".join(sorted(origins))
            self.set_header("Content-Security-Policy", (
                "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
                f"img-src 'self' data: blob: {servers}; base-uri 'none'; form-action 'none'; "
                "frame-ancestors 'none'"))
        self.finish(file.read_bytes())


def _origin_of_tiles(address: str) -> str:
    """Return scheme and server of an address of tiles, as the policy of a page names them."""
    scheme, _, path = address.partition("://")
    # {s} stands for one of several servers; a semicolon would begin another directive.
    return f"{scheme}://{path.partition('/')[0].replace('{s}', '*').replace(';', '')}"


class PageState(Guarded):
    """All that the page shows when it is opened."""

    def get(self, secret: str) -> None:
        """Send what the page shows: the session's control, answers and setting, as JSON."""
        session = self.session
        self.finish({
            **session.state(), "answers": dict(session.answers),
            "setting": page_setting(session, self.pages)})


def page_setting(session: Session, pages: Pages) -> dict[str, Any]:
    """Return what the page gets once, when it is opened, as it does not change afterwards.

    It is JSON on image, map, CRS, files and outputs of the session.
    """
    # The page lays tiles by the box and the resolutions [px of the image, units of the map].
    size = session.size
    box = pages.box
    files_given = session.files
    return {
        "image": {"name": _name_of_image(session),
                  "size": size, "tiles": session.image is not None,
                  "served": None if session.served is None else session.served.info,
                  "resolutions": image_resolutions(size)},
        "map": {"box": box, "resolutions": session.maps.resolutions(box),
                "rasters": [raster.raster.name for raster in session.maps.rasters],
                "vectors": [{"name": layer.name, "collection": layer.collection}
                            for layer in session.maps.vectors],
                "tiles": session.maps.tiles},
        "crs": session.places.crs, "shown": session.places.shown, "folder": str(session.folder),
        "rpc": files_given.rpc, "dem": files_given.dem, "notes": session.notes,
        "matching": can_match(session),
        "outputs": [{"name": name, "label": output.label} for name, output in OUTPUTS.items()
                    if name != "rpc" or session.places.crs != "local"]}


def _name_of_image(session: Session) -> str | None:
    """Return the name of the image on the page; None without an image."""
    if session.served is not None:
        return session.served.id.rstrip("/").rpartition("/")[2]
    return None if session.image is None else session.image.name


class Tile(Guarded):
    """Tiles of the image, of a raster of the map, and of the image on the map."""

    async def get(self, secret: str, layer: str, level: str, column: str,
                  row: str) -> None:
        """Send a tile of a layer as PNG; raise HTTPError 404 if there is none."""
        pixels = await self.run_in_thread(self._tile_png, layer, int(level), int(column), int(row))
        if pixels is None:
            raise HTTPError(404)
        self.set_header("Content-Type", "image/png")
        self.set_header("Cache-Control", "private, max-age=3600")
        self.finish(pixels)

    def _tile_png(self, layer: str, level: int, column: int, row: int) -> bytes | None:
        """Return a tile of a layer (image, warped or mapN) as PNG; None if there is none.

        A warped tile is transparent as long as there is no model.
        """
        session = self.session
        if layer == "image":
            return None if session.image is None else encode_png(
                image_tile(session.image, level, column, row))
        box = box_of_tile(session, self.pages.box, level, column, row)
        if box is None:
            return None
        if layer == "warped":
            if session.image is None or session.prediction is None:
                # The page asks again when there is a model.
                return encode_png(np.zeros((TILE, TILE, 4), dtype=np.uint8))
            return encode_png(warped_tile(session.image, session.prediction, box))
        # The pattern of the address allows digits only.
        number = int(layer.removeprefix("map"))
        if number >= len(session.maps.rasters):
            return None
        return encode_png(session.maps.rasters[number].tile(box, session.maps.shown))


class Call(Guarded):
    """What the page asks the session to do, or to show."""

    async def post(self, secret: str, name: str) -> None:
        """Do what `CALLS` has under a name, and send its answer as JSON.

        A TermselError is sent with the status 422, as the user can correct its cause. Raises
        HTTPError for other types of content, unknown names, and what is no JSON object.
        """
        # A form of another site cannot send this type without asking first.
        if self.request.headers.get("Content-Type", "").partition(";")[0] != "application/json":
            raise HTTPError(415)
        task = CALLS.get(name)
        if task is None:
            raise HTTPError(404)
        try:
            arguments = json.loads(self.request.body)
        # Brackets nested deeply exhaust the stack of the parser.
        except (ValueError, RecursionError) as error:
            raise HTTPError(400) from error
        if not isinstance(arguments, dict):
            raise HTTPError(400)
        try:
            # A fit or a raster may take seconds.
            answer = await self.run_in_thread(task, self.session, self.pages, arguments)
        except TermselError as error:
            self.set_status(422)
            self.finish({"error": f"{error.what}.", "hint": error.hint or "",
                         "ids": list(error.ids)})
            return
        self.finish(answer or {})


def _text_argument(arguments: dict[str, Any], key: str) -> str:
    """Return the text of an argument; raises TermselError if it is none."""
    value = arguments.get(key)
    if not isinstance(value, str):
        raise TermselError(f"{key} is no text")
    return value


def _id_arguments(arguments: dict[str, Any]) -> list[str]:
    """Return the ids of an argument; raises TermselError if they are no list of texts."""
    value = arguments.get("ids")
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise TermselError("ids are no list of names")
    return value


def _box_argument(arguments: dict[str, Any]) -> tuple[float, float, float, float]:
    """Return the box (x min, y min, x max, y max) of a request.

    Raises TermselError if it is no list of four finite numbers.
    """
    box = arguments.get("box")
    if not isinstance(box, list):
        raise TermselError("box is no list of coordinates")
    low, high = check_place_pairs([box[:2], box[2:]])
    return (low[0], low[1], high[0], high[1])


def _put(session: Session, arguments: dict[str, Any]) -> dict[str, Any]:
    """Add or change a feature; return its "id", the "version" and a "note" on its height, or "".

    The note is on a height that stays as the feature moves on the map.
    """
    name = session.put(arguments)
    note = session.note_on_height(name) if arguments.get("map") is not None else ""
    return {"id": name, "version": session.version, "note": note}


def _paste(session: Session, text: str) -> dict[str, Any]:
    """Add the points of a table that was pasted; return their "count" and a "note", "" for none."""
    count, notes = session.paste(text)
    return {"count": count, "note": " ".join(notes)}


CALLS: dict[str, Callable[[Session, Pages, dict[str, Any]], dict[str, Any] | None]] = {
    "put": lambda session, _, arguments: _put(session, arguments),
    "delete": lambda session, _, arguments: session.delete(_id_arguments(arguments)),
    "undo": lambda session, _, __: session.undo(),
    "redo": lambda session, _, __: session.redo(),
    "paste": lambda session, _, arguments: _paste(session, _text_argument(arguments, "text")),
    "add": lambda session, _, arguments: {"count": session.add(arguments.get("points"))},
    "predict": lambda session, _, arguments: {"prediction": session.predict(
        arguments.get("image"), arguments.get("map"))},
    "ground": lambda session, _, arguments: {"ground": session.ground_of(
        check_place_pairs([arguments.get("map")]))[0]},
    "graticule": lambda session, _, arguments: graticule_for_page(
        session, _box_argument(arguments)),
    "vectors": lambda session, _, __: vectors_for_page(session),
    "refine": lambda session, _, arguments: refine_point(session, _text_argument(arguments, "id")),
    "more": lambda session, _, __: {"proposals": propose_points(session)},
    "command": lambda session, _, __: {"command": command_line(session)},
    "save": lambda session, _, arguments: {"files": [
        str(path) for path in save(session, _text_argument(arguments, "name"),
                                   arguments.get("image_id"))]},
}
"""What a page may ask for, by name."""


class Events(WebSocketHandler):
    """Tells a page of every change and answer."""

    pages: Pages

    def initialize(self, pages: Pages) -> None:
        """Keep the pages, which have the session; Tornado calls it before the connection."""
        self.pages = pages

    def check_origin(self, origin: str) -> bool:
        """Return whether the page is this server's own."""
        return origin in {f"http://{host}" for host in self.pages.hosts}

    def prepare(self) -> None:
        """Raise HTTPError 403 for a connection without the secret, or not from this server's page.
        """
        # Browsers open WebSockets across sites, but always say from where.
        if not is_allowed(self) or self.request.headers.get("Origin") is None:
            raise HTTPError(403)

    def write_error(self, status_code: int, **_: Any) -> None:
        """Answer with the status alone, so that a stranger learns nothing."""
        self.finish()

    def log_exception(self, *details: Any) -> None:
        """Log a fault without its request, which has the secret; log nothing of a refusal."""
        if not isinstance(details[1], HTTPError):
            log.error("The events of the page have failed.", exc_info=details)

    def open(self, *_: str, **__: str) -> None:
        """Add this page to those that hear of changes."""
        self.pages.open.add(self)

    def on_message(self, message: str | bytes) -> None:
        """Hear nothing: a page asks by other requests."""

    def on_close(self) -> None:
        """Remove this page from those that hear of changes."""
        self.pages.open.discard(self)

    def send(self, text: str) -> None:
        """Send a message to the page; if that has gone, remove it from the open ones."""
        try:
            self.write_message(text)
        except WebSocketClosedError:
            self.pages.open.discard(self)


def serve(session: Session, port: int, started: Callable[[str, str], None]) -> None:
    """Serve the page until Ctrl-C; `started` is called with its address, and the first one.

    Raises TermselError if the port cannot be used.
    """
    asyncio.run(_serve(session, port, started))


async def _serve(session: Session, port: int, started: Callable[[str, str], None]) -> None:
    """Serve the page on this machine until the task is cancelled.

    `started` is called with the page's address and that to open first, once requests are answered.
    Raises TermselError for a `port` that cannot be used; 0 is any that is free.
    """
    try:
        sockets = bind_sockets(port, address=ADDRESS)
    except OSError as error:
        raise TermselError(f"port {port} cannot be used: {error.strerror}",
                           hint="Choose another --port, or leave it out.") from error
    # Port 0 lets the system choose: the socket knows which.
    pages = Pages(session, sockets[0].getsockname()[1])
    settings = {"pages": pages}
    application = Application([
        (r"/([^/]*)/state", PageState, settings),
        (r"/([^/]*)/tile/(image|warped|map\d{1,3})/(\d{1,2})/(-?\d{1,8})/(-?\d{1,8})\.png", Tile,
         settings),
        (r"/([^/]*)/call/([a-z]+)", Call, settings), (r"/([^/]*)/events", Events, settings),
        (r"/([^/]*)/(.*)", Page, settings), (r"/([^/]*)", First, settings)],
        log_function=lambda _: None, websocket_ping_interval=20)
    server = HTTPServer(application, max_body_size=LARGEST_BODY)
    server.add_sockets(sockets)
    loop = IOLoop.current()
    # Changes come from other threads; WebSockets belong to this one.
    session.tell = lambda message: loop.add_callback(pages.tell, message)
    try:
        started(pages.address, pages.first_address)
        await asyncio.Event().wait()
    finally:
        # The worker may still answer, when nobody listens any more.
        session.tell = lambda _: None
        server.stop()
        pages.threads.shutdown(wait=False, cancel_futures=True)


class First(Guarded):
    """The address that the browser is started with."""

    def prepare(self) -> None:
        """Raise HTTPError 403 for all but the first request, and for one from elsewhere."""
        if not is_allowed(self, self.pages.first):
            raise HTTPError(403)
        # The next request would need a secret that nobody is told.
        self.pages.first = secrets.token_urlsafe(24)

    def get(self, _: str) -> None:
        """Redirect the browser to the page, whose address has the secret."""
        self.redirect(self.pages.address)
