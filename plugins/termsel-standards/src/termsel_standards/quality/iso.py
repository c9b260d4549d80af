"""The report as metadata by ISO 19115-1 with data quality by ISO 19157.

References
----------
ISO/TS 19115-3:2016 and ISO/TS 19157-2:2016, XML schemas of ISO 19115-1 and ISO 19157, at
https://standards.iso.org/iso/19115/-3 and https://standards.iso.org/iso/19157/-2.
"""

from __future__ import annotations

from termsel_standards.quality.elements import Element, Writing
from termsel_standards.quality.report import Measure, Quality, QualitySource, decimal_text

_ISO = "http://standards.iso.org/iso"
_LISTS = f"{_ISO}/19115/resources/Codelists/cat/codelists.xml"
_NAMESPACES = {
    **{name: f"{_ISO}/19115/-3/{name}/{version}" for name, version in (
        ("mdb", "2.0"), ("mrl", "2.0"), ("cit", "2.0"), ("mcc", "1.0"), ("mri", "1.0"),
        ("mrs", "1.0"), ("gex", "1.0"), ("gco", "1.0"))},
    "mdq": f"{_ISO}/19157/-2/mdq/1.0", "gml": "http://www.opengis.net/gml/3.2",
    "xlink": "http://www.w3.org/1999/xlink"}
_METRE = "http://www.opengis.net/def/uom/EPSG/0/9001"

_x = Writing(_NAMESPACES)


def iso_xml(report: Quality) -> str:
    """Return the report as an XML document whose root is mdb:MD_Metadata.

    The standards are ISO 19115-1 and 19157, in the XML of ISO 19115-3.
    """
    # The schema prescribes the order of the elements.
    content = [
        _x("mdb:contact", _organisation_element(report.organisation, "pointOfContact")),
        _x("mdb:dateInfo", _date_element(report.made)),
        _x("mdb:metadataStandard", _citation_element("ISO 19115-1:2014")),
        _x("mdb:referenceSystemInfo", _x("mrs:MD_ReferenceSystem", _x(
            "mrs:referenceSystemIdentifier", _identifier_element(report.crs)))),
        _x("mdb:identificationInfo", _x(
            "mri:MD_DataIdentification", _x("mri:citation", _citation_element(report.title)),
            _string_element("mri:abstract", f"Georeference of {report.title}"),
            _x("mri:spatialRepresentationType", _code_element(
                "mcc:MD_SpatialRepresentationTypeCode", "grid")),
            _x("mri:extent", _extent_element(report)))),
        _x("mdb:dataQualityInfo", _x(
            "mdq:DQ_DataQuality", _x("mdq:scope", _scope_element(report)),
            *(_x("mdq:report", element) for element in _quality_elements(report)))),
        _x("mdb:resourceLineage", _lineage_element(report))]
    return _x.text(_x("mdb:MD_Metadata", *content))


def _quality_elements(report: Quality) -> list[Element]:
    """Return an element of data quality for each figure, and one with the statements, if any.

    Figures on the ground are absolute external accuracy, those in the image accuracy of the grid.
    """
    # ISO 19157 has a class of element for each kind of accuracy.
    elements = [_x("mdq:DQ_AbsoluteExternalPositionalAccuracy" if measure.unit == "m"
                   else "mdq:DQ_GriddedDataPositionalAccuracy", _measure_element(measure),
                   _evaluation_element(report),
                   _x("mdq:result", _x(
                   "mdq:DQ_QuantitativeResult", _time_element("mdq:dateTime", report.made),
                   _x("mdq:resultScope", _scope_element(report)),
                   _x("mdq:value",
                      _x("gco:Record", decimal_text(measure.value))), _unit_element(measure.unit))))
                for measure in report.measures]
    # What is said in words has no measure: a descriptive result.
    if report.statements:
        elements.append(_x("mdq:DQ_AbsoluteExternalPositionalAccuracy", *(
            _x("mdq:result",
               _x("mdq:DQ_DescriptiveResult", _time_element("mdq:dateTime", report.made),
                  _string_element("mdq:statement", words)))
            for words in report.statements)))
    return elements


def _measure_element(measure: Measure) -> Element:
    """Return the element that says which measure a figure is of.

    It has an identifier if the measure is one of ISO 19157.
    """
    if measure.identifier:
        identification = _x("mdq:measureIdentification",
                            _identifier_element(measure.identifier, "ISO 19157:2013"))
    else:
        identification = None
    return _x("mdq:measure", _x("mdq:DQ_MeasureReference", identification,
                                _string_element("mdq:nameOfMeasure", measure.name),
                                _string_element("mdq:measureDescription", measure.description)))


def _evaluation_element(report: Quality) -> Element:
    """Return the element on the method by which figures were found, and its sample of points.

    Both a test and a prediction are inspections of a sample: the points stand for all of the image.
    """
    # A test compares the data with an external source; a prediction compares them with themselves.
    kind = "directInternal" if report.predicted else "directExternal"
    scheme = f"{report.check_points} independent points, chosen before the model was fitted"
    points = report.check_points
    if report.predicted:
        scheme = "control features, each predicted without it; no independent points"
        points = report.control_features
    content = [
        _time_element("mdq:dateTime", report.made),
        _string_element("mdq:evaluationMethodDescription", report.method),
        _x("mdq:evaluationMethodType", _code_element("mdq:DQ_EvaluationMethodTypeCode", kind)),
        _string_element("mdq:samplingScheme", scheme),
        _string_element("mdq:lotDescription", report.title),
        _string_element("mdq:samplingRatio", f"{points} points of the image")]
    return _x("mdq:evaluationMethod", _x("mdq:DQ_SampleBasedInspection", *content))


def _lineage_element(report: Quality) -> Element:
    """Return the element on the sources of the result, the programs that made it and its settings.
    """
    # termsel is the processor; the schema takes other programs as documentation of it.
    software = [_x("mrl:documentation", _citation_element(name, edition))
                for name, edition in report.software.items() if name != "termsel"]
    return _x("mrl:LI_Lineage", _string_element("mrl:statement", report.lineage),
              _x("mrl:scope", _scope_element(report)),
              _x("mrl:processStep", _x(
                  "mrl:LE_ProcessStep", _string_element("mrl:description", report.lineage),
                  *(_x("mrl:source", _source_element(source)) for source in report.sources),
                  _x("mrl:processingInformation", _x(
                      "mrl:LE_Processing",
                      _x("mrl:identifier",
                         _identifier_element("termsel", version=report.software.get(
                          "termsel", ""))),
                      _x("mrl:softwareReference", _citation_element(
                          "termsel", report.software.get("termsel", ""))),
                      *software,
                      _string_element("mrl:runTimeParameters", "; ".join(
                          f"{name}: {value}" for name, value in report.parameters.items())))))))


def _source_element(source: QualitySource) -> Element:
    """Return the element of a source, with its checksum as an identifier."""
    return _x("mrl:LI_Source", _string_element("mrl:description", source.description),
              _x("mrl:sourceCitation", _x(
                  "cit:CI_Citation", _string_element("cit:title", source.name),
                  _x("cit:identifier", _identifier_element(source.sha256, "sha256")))))


def _scope_element(report: Quality) -> Element:
    """Return the element on the scope of figures, which is the whole data set."""
    return _x("mcc:MD_Scope", _x("mcc:level", _code_element("mcc:MD_ScopeCode", "dataset")),
              _x("mcc:extent", _extent_element(report)))


def _extent_element(report: Quality) -> Element:
    """Return the element on the extent: bounds in longitude and latitude [degrees]."""
    names = ("westBoundLongitude", "eastBoundLongitude", "southBoundLatitude", "northBoundLatitude")
    return _x("gex:EX_Extent", _x("gex:geographicElement", _x(
        "gex:EX_GeographicBoundingBox", *(
            _x(f"gex:{name}", _x("gco:Decimal", decimal_text(value)))
            for name, value in zip(names, report.bounds, strict=True)))))


def _organisation_element(name: str, role: str) -> Element:
    """Return the element of an organisation in a role.

    For a name of "" it says that the name is unknown: the schema requires a name or a reason.
    """
    if name:
        party = _string_element("cit:name", name)
    else:
        party = _x("cit:name", attributes={"gco:nilReason": "unknown"})
    return _x("cit:CI_Responsibility", _x("cit:role", _code_element("cit:CI_RoleCode", role)),
              _x("cit:party", _x("cit:CI_Organisation", party)))


def _citation_element(title: str, edition: str = "") -> Element:
    """Return the element of a citation by its title, and its edition if that is not ""."""
    return _x("cit:CI_Citation", _string_element("cit:title", title),
              _string_element("cit:edition", edition) if edition else None)


def _identifier_element(code: str, space: str = "", version: str = "") -> Element:
    """Return the element of a code, with its namespace and version if they are not ""."""
    return _x("mcc:MD_Identifier", _string_element("mcc:code", code),
              _string_element("mcc:codeSpace", space) if space else None,
              _string_element("mcc:version", version) if version else None)


def _date_element(when: str) -> Element:
    """Return the element of a date of creation, given in ISO 8601."""
    return _x("cit:CI_Date", _time_element("cit:date", when),
              _x("cit:dateType", _code_element("cit:CI_DateTypeCode", "creation")))


def _time_element(name: str, when: str) -> Element:
    """Return an element of a name with a time in ISO 8601 as content."""
    return _x(name, _x("gco:DateTime", when))


def _string_element(name: str, text: str) -> Element:
    """Return an element of a name with a text as content."""
    return _x(name, _x("gco:CharacterString", text))


def _code_element(name: str, value: str) -> Element:
    """Return the element of a value in one of the lists of codes of the standard.

    `name` is that of the list, with its prefix. Programs find the list by its address in the
    attributes.
    """
    return _x(name, value, attributes={
        "codeList": f"{_LISTS}#{name.partition(':')[2]}", "codeListValue": value})


def _unit_element(unit: str) -> Element:
    """Return the element of the unit of a figure, "m" or "px"."""
    # OGC defines the metre; pixels are defined here.
    if unit == "m":
        return _x("mdq:valueUnit", attributes={"xlink:href": _METRE})
    return _x("mdq:valueUnit", _x(
        "gml:UnitDefinition", _x("gml:identifier", unit, attributes={"codeSpace": "termsel"}),
        _x("gml:name", "pixel"), attributes={"gml:id": unit}))
