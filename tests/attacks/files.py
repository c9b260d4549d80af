"""Rasters and vector files of a stranger."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

PLACE = ("<SRS>EPSG:4326</SRS><GeoTransform>-56.3,0.01,0,-34.5,0,-0.01</GeoTransform>")


def vrt(source: object, relative: int = 0, before: str = "", attributes: str = "",
        element: str = "SimpleSource", more: str = "") -> str:
    """Return a virtual raster of another file."""
    return (f'{before}<VRTDataset rasterXSize="60" rasterYSize="60"{attributes}>{PLACE}{more}'
            f'<VRTRasterBand dataType="Byte" band="1"><{element}><SourceFilename '
            f'relativeToVRT="{relative}">{escape(str(source))}</SourceFilename><SourceBand>1'
            f"</SourceBand></{element}></VRTRasterBand></VRTDataset>")


def raw(path: object) -> str:
    """Return a virtual raster of the bytes of any file."""
    return ('<VRTDataset rasterXSize="60" rasterYSize="60"><VRTRasterBand dataType="Byte" '
            f'band="1" subClass="VRTRawRasterBand"><SourceFilename relativeToVRT="0">{path}'
            "</SourceFilename><PixelOffset>1</PixelOffset><LineOffset>60</LineOffset>"
            "</VRTRasterBand></VRTDataset>")


def mrf(source: object, data: object) -> str:
    """Return an MRF that copies the pixels of a source into its data file when it is read."""
    return (f"<MRF_META><CachedSource><Source>{source}</Source></CachedSource><Raster>"
            "<Size x='60' y='60' c='1'/><PageSize x='60' y='60' c='1'/><Compression>NONE"
            f"</Compression><DataType>Byte</DataType><DataFile>{data}</DataFile><IndexFile>{data}"
            ".idx</IndexFile></Raster></MRF_META>")


def wms(url: str, cache: object = "") -> str:
    """Return the description of a map service."""
    return (f"<GDAL_WMS><Service name='TMS'><ServerUrl>{url}/${{z}}/${{x}}/${{y}}.png</ServerUrl>"
            "</Service><DataWindow><UpperLeftX>0</UpperLeftX><UpperLeftY>0</UpperLeftY>"
            "<LowerRightX>10</LowerRightX><LowerRightY>10</LowerRightY><SizeX>60</SizeX><SizeY>60"
            "</SizeY><TileLevel>1</TileLevel></DataWindow><BlockSizeX>60</BlockSizeX><BlockSizeY>60"
            f"</BlockSizeY><BandsCount>1</BandsCount><Cache><Path>{cache}</Path></Cache></GDAL_WMS>")


def pipeline(source: object, target: object) -> str:
    """Return a vector file of GDAL that runs a command when it is read."""
    return json.dumps({"type": "gdal_streamed_alg", "command_line":
                       f"gdal vector pipeline ! read {source} ! partition {target} --field f "
                       "--format GeoJSON"})


def ers(data: object) -> str:
    """Return an ERS header, which names the file of its bytes."""
    return ("DatasetHeader Begin\n\tVersion = \"6.0\"\n\tDataFile = \"" + str(data) + "\"\n"
            "\tDataSetType = ERStorage\n\tDataType = Raster\n\tByteOrder = LSBFirst\n"
            "\tRasterInfo Begin\n\t\tCellType = Unsigned8BitInteger\n\t\tNrOfLines = 60\n"
            "\t\tNrOfCellsPerLine = 60\n\t\tNrOfBands = 1\n\tRasterInfo End\nDatasetHeader End\n")


def pds(data: object) -> str:
    """Return a label of PDS, which names the file of its bytes."""
    return ("PDS_VERSION_ID = PDS3\r\nRECORD_TYPE = FIXED_LENGTH\r\nRECORD_BYTES = 60\r\n"
            f'FILE_RECORDS = 60\r\n^IMAGE = "{data}"\r\nOBJECT = IMAGE\r\nLINES = 60\r\n'
            "LINE_SAMPLES = 60\r\nSAMPLE_TYPE = UNSIGNED_INTEGER\r\nSAMPLE_BITS = 8\r\n"
            "END_OBJECT = IMAGE\r\nEND\r\n")


def isis(data: object) -> str:
    """Return a label of ISIS 3, which names the file of its bytes."""
    return (f"Object = IsisCube\nObject = Core\n^Core = {data}\nStartByte = 1\nFormat = "
            "BandSequential\nGroup = Dimensions\nSamples = 60\nLines = 60\nBands = 1\nEnd_Group\n"
            "Group = Pixels\nType = UnsignedByte\nByteOrder = Lsb\nBase = 0.0\nMultiplier = 1.0\n"
            "End_Group\nEnd_Object\nEnd_Object\nEnd\n")


def ogr_vrt(source: object) -> str:
    """Return a virtual vector file."""
    return (f'<OGRVRTDataSource><OGRVRTLayer name="kept"><SrcDataSource relativeToVRT="0">{source}'
            "</SrcDataSource></OGRVRTLayer></OGRVRTDataSource>")


def auxiliary(overview: object) -> str:
    """Return auxiliary XML that names the overviews of a raster."""
    return ('<PAMDataset><Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">'
            f"{overview}</MDI></Metadata></PAMDataset>")


def image(path: Path, size: int = 60, **profile: object) -> Path:
    """Write a small GeoTIFF."""
    import rasterio

    with rasterio.open(path, "w", driver="GTiff", width=size, height=size, count=1, dtype="uint8",
                       crs="EPSG:4326",
                       transform=rasterio.transform.from_origin(-56.3, -34.5, 0.01, 0.01),
                       **profile) as raster:
        raster.write(np.arange(size * size).reshape(1, size, size).astype("uint8"))
    return path


def zipped(path: Path, name: str, text: str) -> Path:
    """Write an archive of one text."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(name, text)
    return path
