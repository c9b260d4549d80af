"""Whether the page is complete: OpenLayers comes with the wheel, and is not in the repository."""

from __future__ import annotations

from importlib.resources import files

from termsel import TermselError


def require_page() -> None:
    """Raise TermselError where the package was built without OpenLayers."""
    if not files("termsel_app").joinpath("page", "vendor", "ol.js").is_file():
        raise TermselError("this copy of termsel-app was built without its map library",
                           hint="Install Node.js, whose npm fetches it, then install termsel-app "
                                "again.")
