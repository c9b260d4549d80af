"""Names of the fields of a layer of points, as termsel's command line knows those of columns.

The plugin runs in the Python of QGIS, where termsel need not be installed: the names stand here
again, and a test holds them against termsel's.
"""

import re
import unicodedata

KNOWN = {
    "id": "id name pt ptid ptno point points pointid pointname pointno pointnr pointnumber "
          "gcp gcpid gcpno gcpname gcplabel label nr no num number pkt pktnr punkt punktid "
          "punktnr punktnummer punktname passpunkt nummer numer numero nom nombre punto "
          "idpunto nome ponto punt puntnummer nazwa naam 点 点号 點號 点名 编号 序号 名称 id号 bod "
          "cislobodu pont pontszam nokta tunnus punctul tocka tocke точка точки номер "
          "номерточки назва σημειο 点番号 점 점번호 fid",
    "role": "role",
    "line": "line row ypx lin lines rows ypix ypixel pixely py imgy imagey yimg yimage lineno "
          "yimagen yimagem imy imrow imgrow imagerow fil renglon yпикс "
          "zeile bildzeile bildy ligne rangee fila linea riga linha wiersz rij regel 行 行号 行数 "
          "行坐标 图像行 影像行 像素行 图像y 影像y 像素y pxy "
          "riadok radek sor satir rivi rad rekke række rand redak vrstica "
          "строка ряд рядок γραμμη 행 sourcey",
    "sample": "sample col column xpx pixel samples samp cols columns xpix xpixel pixelx pix px "
          "ximagen ximagem imx imcol imgcol imagecol xпикс "
          "imgx imagex ximg ximage spalte bildspalte bildx colonne columna muestra colonna "
          "campione coluna kolumna kolom 列 列号 列数 列坐标 "
          "图像列 影像列 像素列 图像x 影像x 像素x pxx sloupec stlpec oszlop sutun "
          "sarake kolumn kolonne coloana stupac stolpec столбец колонка стовпець στηλη 열 sourcex",
    "z": "z h height elev elevation alt altitude geoz hohe hoehe hoheunn hoheunhn hauteur altura "
          "altitud altitudine altezza cota quota elevazione elevacion elevacao wysokosc "
          "hoogte pointz ellipsoidalheight ellheight 高程 高度 高 大地高 海拔 vyska magassag "
          "yukseklik korkeus hojd høyde højde visina высота висота υψομετρο 標高 고도 표고"}
"""Names of each meaning, without accents and signs, the usual ones first."""

PASSED_ON = ("enabled enable sigmaline sigmasample sigmapx use used inuse isused "
             "active isactive activated valid isvalid ok accepted inlier isinlier "
             "benutzen benutzt verwenden verwendet aktiv gultig utiliser utilise actif "
             "valide usar usado activo activado valido uso ativo ativado usato attivo "
             "gebruikt actief uzyty aktywny pouzit aktivni aktivt использовать "
             "используется вкл включена включен активна активен 使用 启用 有效 사용 outlier "
             "isoutlier blunder isblunder excluded exclude ignore ignored disabled "
             "disable rejected reject isrejected skip deleted ausreisser "
             "ausgeschlossen ignorieren gesperrt aberrant exclu ignorer excluido "
             "excluir ignorar atipico escluso ignorato исключить исключена выкл выброс "
             "排除 禁用 粗差 status state flag estado stato statut zustand статус check "
             "ischeck checkpoint ischeckpoint checkpt cp iscp validation test istest "
             "testpoint independent isindependent holdout kontrollpunkt prufpunkt "
             "pruefpunkt verificacion verifica controle контроль контрольная 检查点 检核点")
"""Names of fields that tell which points are used, or how exact they are: termsel reads them."""

_UNIT = re.compile(r"\s*[\[({<【].*$|[\s_.-]+(px|pix|pixels?|m|km|ft|feet|us[_-]?ft|gon|rad|deg|"
                   r"degrees?|dms|wgs84|utm)$", re.IGNORECASE)


def fold_name(name):
    """Return a name in small letters, without accents, spaces and signs such as hyphens."""
    letters = unicodedata.normalize("NFKD", name.casefold().replace("ł", "l").replace("ı", "i"))
    without_accents = "".join(sign for sign in letters if not unicodedata.combining(sign))
    return re.sub(r"[\W_]", "", without_accents)


def field_of(meaning, fields):
    """Return the name of the field that has a meaning, such as "line"; None if there is none.

    Accents, signs and units do not count: "Line (px)" is a line. If several of the names `fields`
    have the meaning, it is the one that comes first in `KNOWN`.
    """
    # Each name as it is and without its unit: "Y_px" is known as it is, "line_px" without.
    forms = {}
    for name in fields:
        normal = unicodedata.normalize("NFKC", name.strip().casefold())
        forms.setdefault(fold_name(normal), name)
        forms.setdefault(fold_name(_UNIT.sub("", normal)), name)
    known = map(fold_name, KNOWN[meaning].split())
    return next((forms[name] for name in known if name in forms), None)


def passed_on(fields, taken):
    """Return the names of the fields that termsel reads beside those that are `taken`.

    Whether a point is used, and how exact it is, is so read as from any other table.
    """
    known = set(map(fold_name, PASSED_ON.split()))
    # "sigma_px" is known as it is, "sigma_line [px]" without its unit.
    return [name for name in fields if name not in taken
            and known.intersection([fold_name(name), fold_name(_UNIT.sub("", name.strip()))])]


def heading(meaning, field):
    """Return the heading of a column: its meaning, with the unit that the name of its field states.

    The command line converts by this unit, as for a height of "H [km]" or "z_ft". `field` is None
    for a column without a field.
    """
    unit = _UNIT.search(field.strip()) if field else None
    return meaning + unit.group() if unit else meaning
