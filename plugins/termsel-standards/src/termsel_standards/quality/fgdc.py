"""The report as metadata of the FGDC.

References
----------
FGDC-STD-001-1998, Content Standard for Digital Geospatial Metadata. What it requires and a
georeference does not show is "Unknown", as the standard allows.
"""

from __future__ import annotations

from termsel_standards.quality.elements import Element, Writing
from termsel_standards.quality.report import Quality, QualitySource, decimal_text

STANDARD = ("FGDC Content Standard for Digital Geospatial Metadata", "FGDC-STD-001-1998")
_UNKNOWN, _NONE = "Unknown", "None"

_x = Writing()


def fgdc_xml(report: Quality) -> str:
    """Return the report as an XML document whose root is `metadata`.

    The standard is the Content Standard for Digital Geospatial Metadata of the FGDC. It takes
    errors on the ground alone for positional accuracy, so figures in px are left out. What it
    requires and termsel does not know is "Unknown".
    """
    # The standard writes dates without dashes.
    date = report.made[:10].replace("-", "")
    west, east, south, north = map(decimal_text, report.bounds)
    identification = _x(
        "idinfo", _x("citation", _citation_element(report.title, report.organisation, date)),
        _x("descript", _x("abstract", f"Georeference of {report.title}"), _x("purpose", _UNKNOWN)),
        _x("timeperd", _date_element(_UNKNOWN), _x("current", _UNKNOWN)),
        _x("status", _x("progress", "Complete"), _x("update", "None planned")),
        *_bounds_and_use(west, east, south, north))
    # Section 2 of the standard, data quality: a report in words, then each figure with its method.
    figures = [_x("qhorizpa", _x("horizpav", decimal_text(measure.value)),
                  _x("horizpae", f"{measure.name} [m]: {measure.description}"))
               for measure in report.measures if measure.unit == "m"]
    sources = [_source_element(source, f"source {i}") for i, source in enumerate(report.sources, 1)]
    sources_used = [_x("srcused", f"source {i}") for i, _ in enumerate(report.sources, 1)]
    quality = _x(
        "dataqual",
        _x("logic", "Not applicable to an image"), _x("complete", "Not applicable to an image"),
        _x("posacc", _x(
            "horizpa", _x("horizpar", " ".join(f"{sentence.rstrip('.')}." for sentence in (
                report.method, *report.statements))),
            *figures)),
        _x("lineage", *sources, _x("procstep", _x("procdesc", _process_text(report)), *sources_used,
                                   _x("procdate", date))))
    metadata = _x("metainfo", _x("metd", date), _x("metc", _contact_element(report.organisation)),
                  _x("metstdn", STANDARD[0]), _x("metstdv", STANDARD[1]))
    return _x.text(_x("metadata", identification, quality, metadata))


def _bounds_and_use(west: str, east: str, south: str, north: str) -> list[Element]:
    """Return the elements of bounds [degrees], keywords, and constraints on access and use.

    The standard requires all of them; constraints, which termsel does not know, are "Unknown".
    """
    return [_x("spdom", _x("bounding", _x("westbc", west), _x("eastbc", east),
                           _x("northbc", north), _x("southbc", south))),
            _x("keywords", _x("theme", _x("themekt", _NONE), _x("themekey", "imagery"))),
            _x("accconst", _UNKNOWN), _x("useconst", _UNKNOWN)]


def _process_text(report: Quality) -> str:
    """Return sentences on what was done, by which software and with which settings."""
    software = ", ".join(f"{name} {version}" for name, version in report.software.items())
    settings = "; ".join(f"{name}: {value}" for name, value in report.parameters.items())
    return f"{report.lineage} Software: {software}. Settings: {settings}."


def _source_element(source: QualitySource, short: str) -> Element:
    """Return the element of a source and its checksum; `short` is the name it is cited by."""
    return _x("srcinfo", _x("srccite", _citation_element(source.name, "", _UNKNOWN)),
              _x("typesrc", "digital file"), _x("srctime", _date_element(_UNKNOWN),
                                                _x("srccurr", _UNKNOWN)),
              _x("srccitea", short), _x("srccontr",
                                        f"{source.description}; sha256 {source.sha256}"))


def _citation_element(title: str, origin: str, date: str) -> Element:
    """Return the element of a citation; an origin of "" becomes "Unknown"."""
    return _x("citeinfo", _x("origin", origin or _UNKNOWN), _x("pubdate", date), _x("title", title))


def _date_element(date: str) -> Element:
    """Return the element of a single date, YYYYMMDD or "Unknown"."""
    return _x("timeinfo", _x("sngdate", _x("caldate", date)))


def _contact_element(organisation: str) -> Element:
    """Return the element of a contact: the organisation, and "Unknown" for its address and phone.

    An organisation of "" is "Unknown" too.
    """
    return _x("cntinfo", _x("cntorgp", _x("cntorg", organisation or _UNKNOWN)),
              _x("cntaddr", _x("addrtype", _UNKNOWN), _x("city", _UNKNOWN), _x("state", _UNKNOWN),
                 _x("postal", _UNKNOWN)),
              _x("cntvoice", _UNKNOWN))
