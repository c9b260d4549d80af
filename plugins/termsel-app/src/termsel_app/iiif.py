"""Images of the IIIF, which the browser fetches from their server: only where the user allows it.

References
----------
IIIF Image API 2.1 and 3.0, https://iiif.io/api/image/3.0/.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any
from urllib.error import URLError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

from termsel import TermselError

INFO = "/info.json"
MAX_DESCRIPTION_BYTES = 2**20
"""Bytes of a description that are read."""
SECONDS = 20
_ID = re.compile(r"https?://[\w.:\[\]-]+(/[^\s;,'\"\x00-\x1f\x7f]*)?", re.ASCII)
"""The id of an image. Its server is written into the content policy of the page, so it must not
have signs that separate parts of a policy."""
KEPT = ("@context", "id", "@id", "type", "protocol", "profile", "width", "height", "tiles", "sizes",
        "maxWidth", "maxHeight", "maxArea", "extraFormats", "extraQualities", "extraFeatures",
        "preferredFormats")
"""Parts of a description that the page gets."""


@dataclass(frozen=True)
class IiifImage:
    """An image on a server: its description, lines and samples, and where its tiles come from."""

    info: dict[str, Any]
    id: str
    size: tuple[int, int]

    @property
    def origin(self) -> str:
        """The scheme and server of its tiles."""
        address = urlsplit(self.id)
        return f"{address.scheme}://{address.netloc}"


def is_iiif(name: str | None) -> bool:
    """Return whether the name of an image is the address of an info.json; False for None."""
    return name is not None and name.startswith(("http://", "https://")) and name.endswith(INFO)


def fetch_image(address: str, remote: bool) -> IiifImage:
    """Return the image whose description is at an address.

    Raises TermselError if `remote` is False, so that no server may be asked; if termsel-iiif is not
    installed; if the address cannot be fetched; or if what is there describes no image.
    """
    if not remote:
        raise TermselError("this image is on a server, and access to servers is not allowed",
                           file=address,
                           hint="Add --allow-remote.")
    if find_spec("termsel_iiif") is None:
        raise TermselError("images of the IIIF need the package termsel-iiif", file=address,
                           hint="Install it: pip install termsel-iiif.")
    # One byte more than is read shows that a description is too long.
    try:
        request = Request(address, headers={"Accept": "application/json"})
        with urlopen(request, timeout=SECONDS) as answer:
            content = answer.read(MAX_DESCRIPTION_BYTES + 1)
    except (URLError, OSError, ValueError) as error:
        raise TermselError(f"the image cannot be fetched: {error}", file=address,
                           hint="Check the address and the network.") from error
    return parse_image_info(content, address)


def parse_image_info(content: bytes, address: str) -> IiifImage:
    """Return the image that the content of an info.json describes.

    `address` is for messages. Raises TermselError if it describes none, or states no size.
    """
    try:
        info = json.loads(content) if len(content) <= MAX_DESCRIPTION_BYTES else None
    except (ValueError, RecursionError):
        info = None
    # Version 3 of the Image API calls it id, earlier ones @id.
    name = None if not isinstance(info, dict) else info.get("id", info.get("@id"))
    if not isinstance(info, dict) or not isinstance(name, str) or not _ID.fullmatch(name):
        raise TermselError("this is no description of an IIIF image", file=address,
                           hint="Give the address of its info.json.")
    size = (info.get("height"), info.get("width"))
    if not all(type(number) is int and 0 < number < 2**31 for number in size):
        raise TermselError("the description of this image does not state its size",
                           file=address,
                           hint="Save the image at full size, and give that file.")
    kept = {key: info[key] for key in KEPT if key in info}
    if isinstance(kept.get("tiles"), list):
        kept["tiles"] = [_square_without_height(tile) for tile in kept["tiles"]]
    return IiifImage(kept, name, (int(size[0] or 0), int(size[1] or 0)))


def _square_without_height(tile: Any) -> Any:
    """Return the description of tiles with a height, which is the width if none is stated.

    The Image API says so (3.0, section 5.4), but OpenLayers would take another height. What is no
    description of tiles is returned unchanged.
    """
    if isinstance(tile, dict) and "width" in tile:
        return {"height": tile["width"], **tile}
    return tile
