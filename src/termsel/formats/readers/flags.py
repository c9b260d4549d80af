"""Columns that say which rows of a table are in use: by 1 and 0, yes and no, true and false."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from termsel.data.features import ROLES
from termsel.data.roles import FIELD_ROLES
from termsel.data.tables.columns import fold_name

_WHOLE = re.compile(r"([01])\.0*")

_WORDS = {
    "true": "1 true t yes y on ja oui vrai si sì sí sim verdadeiro verdadero vero wahr tak ano "
            "igen да истина 是 真",
    "false": "0 false f no n off nein nee non faux não nao falso falsch nie ne nem нет ложь 否 假",
    "in use": "use used inuse isused active isactive activated valid isvalid ok accepted inlier "
              "isinlier benutzen benutzt verwenden verwendet aktiv gultig utiliser utilise actif "
              "valide usar usado activo activado valido uso ativo ativado usato attivo gebruikt "
              "actief uzyty aktywny pouzit aktivni aktivt использовать используется вкл включена "
              "включен активна активен 使用 启用 有效 사용",
    "out of use": "outlier isoutlier blunder isblunder excluded exclude ignore ignored disabled "
                  "disable rejected reject isrejected skip deleted ausreisser ausgeschlossen "
                  "ignorieren gesperrt aberrant exclu ignorer excluido excluir ignorar atipico "
                  "escluso ignorato исключить исключена выкл выброс 排除 禁用 粗差",
    "either": "status state flag estado stato statut zustand статус",
    "checks": "check ischeck checkpoint ischeckpoint checkpt cp iscp validation test istest "
              "testpoint independent isindependent holdout kontrollpunkt prufpunkt pruefpunkt "
              "verificacion verifica controle контроль контрольная 检查点 检核点"}
"""Cells that stand for true and false, and names of columns: without accents, signs and capitals.

Columns "in use" are true for rows in use, those "out of use" for the others; programs use "either"
in both senses. Those of "checks" may be true for independent check points.
"""

_TRUE, _FALSE = (frozenset(_WORDS[sense].split()) for sense in ("true", "false"))
# Folded as the headings are that they are compared with, which takes Korean syllables apart.
_IN_USE, _OUT_OF_USE, _EITHER, _CHECKS = (
    frozenset(map(fold_name, _WORDS[sense].split()))
    for sense in ("in use", "out of use", "either", "checks"))


def truth_of(cell: str) -> bool | None:
    """Return what a cell stands for; None if it is neither true nor false, as a blank one is.

    Examples
    --------
    >>> truth_of(" 1.0"), truth_of("Nein"), truth_of("7")
    (True, False, None)
    """
    text = cell.strip().casefold()
    # Programs that keep numbers alone write 1.0 for 1.
    whole_number = _WHOLE.fullmatch(text)
    text = whole_number[1] if whole_number else text
    if text in _TRUE:
        return True
    return False if text in _FALSE else None


def find_flags(header: Sequence[str], rows: Sequence[Sequence[str]], taken: Collection[int],
               ) -> tuple[list[int], list[bool]] | None:
    """Return the columns whose names say that they tell which rows are in use, and which are.

    A column counts if each of its cells is true, false or blank, and if it leaves some rows in use
    and others not. A blank cell leaves its row in use. Of several columns, all must leave a row in
    use. Columns `taken` have another meaning. Returns None if there is no such column.
    """
    found = []
    in_use = [True] * len(rows)
    for i, name in enumerate(header):
        folded = fold_name(name)
        if i in taken or folded not in _IN_USE | _OUT_OF_USE:
            continue
        cells = [row[i] for row in rows]
        truths = [truth_of(cell) for cell in cells]
        # Any other word makes it a column of something else.
        if any(truth is None and cell.strip()
               for truth, cell in zip(truths, cells, strict=True)):
            continue
        # "excluded" says of rows in use that they are false.
        means_off = folded in _OUT_OF_USE
        stays = [truth is None or truth is not means_off for truth in truths]
        if any(stays) and not all(stays):
            found.append(i)
            in_use = [before and now for before, now in zip(in_use, stays, strict=True)]
    return (found, in_use) if any(in_use) and found else None


def remarks_on_unread(header: Sequence[str], rows: Sequence[Sequence[str]],
                      taken: Collection[int]) -> list[str]:
    """Return sentences on columns that are not read and look like roles or like flags.

    Columns `taken` are read. A column looks like roles if it has two or more different words, each
    of which is a role of termsel or a word of the field for one.
    """
    remarks = []
    for i, name in enumerate(header):
        if i in taken:
            continue
        name = name.strip()
        words = list(dict.fromkeys(filter(None, (row[i].strip() for row in rows))))
        # One word alone, such as "control" in all rows, tells nothing apart.
        if len(words) > 1 and all(fold_name(word) in FIELD_ROLES or word.casefold() in ROLES
                                  for word in words):
            remarks.append(f"column {name!r} looks like roles ({', '.join(words[:4])}) and is not "
                           f"read: --columns role={name} reads it")
        if {truth_of(word) for word in words} != {True, False}:
            continue
        true_word = next(word for word in words if truth_of(word))
        if fold_name(name) in _EITHER:
            remarks.append(f"column {name!r} is not read: if {true_word} stands for a row in use, "
                           f"--columns enabled={name} leaves the others out")
        elif fold_name(name) in _CHECKS:
            remarks.append(f"column {name!r} is not read: if {true_word} stands for a check point, "
                           "--role ID=independent keeps each of them out of the fit")
    return remarks
