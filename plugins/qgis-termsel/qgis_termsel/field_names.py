"""Names of the fields of a layer of points, as termsel's command line knows those of columns.

The plugin runs in the Python of QGIS, where termsel need not be installed: the names stand here
again, and a test holds them against termsel's.
"""

import re
import unicodedata

KNOWN = {
    "id": "id name pt ptid ptno point points pointid pointname pointno pointnr pointnumber gcp "
          "gcpid gcpno gcpname gcplabel label nr no num number pkt pktnr punkt punktid punktnr "
          "punktnummer punktname passpunkt nummer numer numero nom nombre punto idpunto nome "
          "ponto punt puntnummer nazwa naam 点 点号 点名 编号 序号 名称 id号 fid",
    "role": "role use",
    "line": "line row ypx lin lines rows ypix ypixel pixely py imgy imagey yimg yimage lineno "
          "zeile bildzeile bildy ligne rangee fila linea riga linha wiersz rij regel 行 行号 行数 "
          "行坐标 sourcey",
    "sample": "sample col column xpx pixel samples samp cols columns xpix xpixel pixelx pix px "
          "imgx imagex ximg ximage spalte bildspalte bildx colonne columna muestra colonna "
          "campione coluna kolumna kolom 列 列号 列数 列坐标 sourcex",
    "z": "z h height elev elevation alt altitude hohe hoehe hoheunn hoheunhn hauteur altura "
          "altitud altitudine altezza cota quota elevazione elevacion elevacao wysokosc hoogte "
          "pointz ellipsoidalheight ellheight 高程 高度 高 大地高 海拔"}
"""Names of each meaning, without accents and signs, the usual ones first."""

_UNIT = re.compile(r"\s*[\[({<【].*$|[\s_.-]+(px|pix|pixels?|m|deg|degrees?|dms|wgs84|utm)$")


def fold_name(name):
    """Return a name in small letters, without accents, spaces and signs."""
    letters = unicodedata.normalize("NFKD", name.casefold().replace("ł", "l"))
    without_accents = "".join(sign for sign in letters if not unicodedata.combining(sign))
    return re.sub(r"[\W_]", "", without_accents)


def field_of(meaning, fields):
    """Return the field that has a meaning, of names as the layer has them; None without one.

    Of several the one whose name is the more usual. Units count for nothing: "Line (px)" is line.
    """
    forms = {}
    for name in fields:
        normal = unicodedata.normalize("NFKC", name.strip().casefold())
        forms.setdefault(fold_name(normal), name)
        forms.setdefault(fold_name(_UNIT.sub("", normal)), name)
    return next((forms[known] for known in KNOWN[meaning].split() if known in forms), None)
