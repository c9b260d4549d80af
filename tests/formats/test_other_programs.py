"""Programs other than termsel, where they are installed, see what the fitted model sees."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import termsel
from benchmarks import clients

pytest.importorskip("rasterio")


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[termsel.Result, Path]:
    folder = tmp_path_factory.mktemp("clients")
    return clients.scene(folder), folder


@pytest.mark.skipif(not shutil.which("gdaltransform"), reason="needs gdal-bin")
def test_gdal_sees_what_the_model_sees(exported: tuple[termsel.Result, Path]) -> None:
    apart = {form: found for _, _, form, found in clients.by_gdal(*exported)}
    assert max(apart[form] for form in clients.RPCS) < 1e-6
    assert apart["gcp-grid-vrt"] < 0.1
    assert apart["geolocation-vrt"] < 0.01


@pytest.mark.skipif(not shutil.which("otbcli_ConvertSensorToGeoPoint"), reason="needs otb-bin")
def test_otb_sees_what_the_model_sees(exported: tuple[termsel.Result, Path],
                                      monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clients, "PLACES", 4)
    apart = {form: found for _, _, form, found in clients.by_otb(*exported)}
    assert max(apart["rpc-txt"], apart["rpc-vrt"]) < 0.5
    assert np.isinf(apart["rpb"])  # OTB looks for a _RPC.TXT alone
