"""Kinds of hostile Excel workbooks."""

from __future__ import annotations

import functools
import io
import struct
import zipfile
from collections.abc import Mapping, Sequence

import numpy as np
from hostile_kinds import (
    HEADER,
    KINDS,
    File,
    Rng,
    columns,
    damage,
    flipped,
    kind,
    near,
    pick,
    sound_xlsx,
)

XML = b'<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'
MAIN = b'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGE = "http://schemas.openxmlformats.org/package/2006"
TYPE = "application/vnd.openxmlformats-officedocument.spreadsheetml"
ROOM = 30_000_000  # bytes of a part


def header_row() -> bytes:
    cells = b"".join(b'<c t="inlineStr"><is><t>%s</t></is></c>' % name.encode() for name in HEADER)
    return b'<row r="1">' + cells + b"</row>"


def rows(count: int, start: int = 2) -> bytes:
    return b"".join(
        b'<row r="%d">' % (start + i) + b"".join(b"<c><v>%.10g</v></c>" % value for value in row) + b"</row>"
        for i, row in enumerate(columns(count).tolist())
    )


def sheet(*content: bytes, before: bytes = b"", after: bytes = b"") -> bytes:
    data = b"".join([header_row(), rows(20), *content])
    return (
        XML + b"<worksheet " + MAIN + b">" + before + b"<sheetData>" + data + b"</sheetData>" + after + b"</worksheet>"
    )


def relations(targets: Sequence[tuple[str, str]]) -> bytes:
    each = "".join(
        f'<Relationship Id="rId{i}" Type="{OFFICE}/{what}" Target="{target}"/>'
        for i, (what, target) in enumerate(targets)
    )
    return XML + f'<Relationships xmlns="{PACKAGE}/relationships">{each}</Relationships>'.encode()


def parts(
    first: bytes, targets: Sequence[str] = ("worksheets/sheet1.xml",), more: bytes = b"", **others: bytes
) -> dict[str, bytes]:
    """Parts of a workbook by name; `others` are styles, sharedStrings and so on."""
    names = {"styles": "styles", "sharedStrings": "sharedStrings", "theme": "theme"}
    linked = [("worksheet", target) for target in targets] + [(names[name], f"{name}.xml") for name in others]
    sheets = "".join(f'<sheet name="s{i}" sheetId="{i + 1}" r:id="rId{i}"/>' for i in range(len(targets)))
    types = [("xl/workbook.xml", "sheet.main"), *((f"xl/{target}", "worksheet") for target in targets)]
    types += [(f"xl/{name}.xml", name) for name in others]
    kinds = "".join(
        f'<Override PartName="/{name}" ContentType="{TYPE}.{what}+xml"/>' for name, what in dict(types).items()
    )
    return {
        "[Content_Types].xml": XML + f'<Types xmlns="{PACKAGE}/content-types">{kinds}</Types>'.encode(),
        "_rels/.rels": relations([("officeDocument", "xl/workbook.xml")]),
        "xl/_rels/workbook.xml.rels": relations(linked),
        "xl/workbook.xml": XML + b"<workbook " + MAIN + f' xmlns:r="{OFFICE}"><sheets>{sheets}</sheets>'.encode()
        + more + b"</workbook>",
        "xl/worksheets/sheet1.xml": first,
        **{f"xl/{name}.xml": content for name, content in others.items()},
    }  # fmt: skip


def zipped(content: Mapping[str, bytes], rng: Rng, padded: bool = True) -> File:
    """Workbook; noise in it keeps its ratio small, so that no limit of the ratio refuses it."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in content.items():
            archive.writestr(name, part)
        if padded:
            archive.writestr("xl/media/image1.png", rng.bytes(sum(map(len, content.values())) // 200), 0)
    return File(pick(rng, "rig.xlsx", "rig.xlsm"), stream.getvalue())


def book(rng: Rng, *content: bytes, padded: bool = True, **more: bytes) -> File:
    return zipped(parts(sheet(*content), **more), rng, padded)  # pyright: ignore[reportArgumentType]


def filled(piece: bytes, size: float = ROOM) -> bytes:
    return piece * max(1, int(size) // len(piece))


@kind
def xlsx_bomb(rng):
    """One part of gigabytes, of which the directory tells the truth."""
    content = parts(sheet())
    stream = io.BytesIO(zipped(content, rng, padded=False).content)
    with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive:
        name = pick(rng, "xl/worksheets/sheet2.xml", "xl/media/image1.png", "docProps/core.xml")
        archive.writestr(name, bytes(near(rng, 4e8)))
    return File("rig.xlsx", stream.getvalue())


@kind
def xlsx_bomb_just_below_the_limits(rng):
    return book(rng, filled(pick(rng, b"<row><c/></row>", b'<row><c t="s"/></row>', b" "), near(rng, 2e8)))


@kind
def xlsx_in_xlsx(rng):
    content = zipped(parts(sheet()), rng).content
    for _ in range(20):
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for i in range(10):
                archive.writestr(f"xl/worksheets/sheet{i}.xml", content)
        content = stream.getvalue()[: 10**6]
    return zipped({**parts(sheet()), "xl/embeddings/book.xlsx": content, "xl/worksheets/sheet1.xml": content}, rng)


def directory(content: bytes) -> tuple[int, bytes]:
    """Place of the central directory of a zip file, and the directory."""
    size, at = struct.unpack_from("<2I", content, len(content) - 10)
    return at, content[at : at + size]


def with_directory(content: bytes, entries: Sequence[bytes]) -> bytes:
    at, _ = directory(content)
    joined, count = b"".join(entries), min(len(entries), 65535)
    return content[:at] + joined + struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, count, count, len(joined), at, 0)


def entries(content: bytes) -> list[bytes]:
    found, rest = [], directory(content)[1]
    while rest:
        size = 46 + sum(struct.unpack_from("<3H", rest, 28))
        found, rest = [*found, rest[:size]], rest[size:]
    return found


@kind
def xlsx_parts_that_overlap(rng):
    """Hundreds of sheets whose directory entries all lead to one squeezed part."""
    count = near(rng, 250)
    content = parts(sheet(rows(near(rng, 4000))), [f"worksheets/sheet{i + 1}.xml" for i in range(count)])
    file = zipped({**content, "xl/media/image2.png": rng.bytes(10**6)}, rng)
    all_of = entries(file.content)
    one = next(entry for entry in all_of if b"sheet1.xml" in entry)
    named = [b"xl/worksheets/sheet%d.xml" % (i + 1) for i in range(1, count)]
    copies = [one[:28] + struct.pack("<H", len(name)) + one[30:46] + name for name in named]
    return File("rig.xlsx", with_directory(file.content, [*all_of, *copies]))


@kind
def xlsx_directory_that_lies(rng):
    """On the sizes, checksums, methods or places of parts."""
    content = book(rng, filled(b"<row/>", pick(rng, 1e3, 3e8)), padded=False).content
    changed = []
    for entry in entries(content):
        data = bytearray(entry)
        at = pick(rng, 10, 16, 20, 24, 42)
        value = pick(rng, 0, 1, 12, 99, 1000, 2**31, 2**32 - 1)
        if rng.integers(2) or b"sheet1.xml" in entry:
            struct.pack_into("<H" if at == 10 else "<I", data, at, value % (2**16 if at == 10 else 2**32))
        changed.append(bytes(data))
    return File("rig.xlsx", with_directory(content, changed))


@kind
def xlsx_wrong_checksum(rng):
    content = book(rng, rows(near(rng, 500), 30), padded=False).content
    changed = [entry[:16] + rng.bytes(4) + entry[20:] if rng.integers(2) else entry for entry in entries(content)]
    return File("rig.xlsx", with_directory(content, changed))


@functools.lru_cache(1)
def crowded(count: int) -> bytes:
    return zipped(
        {**parts(sheet()), **{f"x{i}{'.xml' * (i % 2)}": b"" for i in range(count)}}, np.random.default_rng()
    ).content


@kind
def xlsx_65000_members(rng):
    return File(pick(rng, "rig.xlsx", "rig.xlsm", "rig.zip"), crowded(65_000))


@kind
def xlsx_500_sheets_of_one_part(rng):
    return zipped(parts(sheet(rows(near(rng, 5000), 30)), ["worksheets/sheet1.xml"] * 500), rng)


@kind
def xlsx_many_sheets_that_are_missing(rng):
    return zipped(parts(sheet(), [f"worksheets/{'x' * (i % 9)}{i}.xml" for i in range(near(rng, 5000))]), rng)


@kind
def xlsx_one_long_text_in_each_cell(rng):
    """A million references to one text of 10 kB, as numbers or notes."""
    at = bool(rng.integers(2))
    cell, number = b'<c t="s"><v>0</v></c>', b"<c><v>1</v></c>"
    row = b"<row>" + number * (3 if at else 4) + cell + b"</row>"
    shared = XML + b"<sst " + MAIN + b"><si><t>" + b"x" * near(rng, 10_000) + b"</t></si></sst>"
    return book(rng, row * near(rng, 400_000), sharedStrings=shared)


@kind
def xlsx_shared_texts(rng):
    """As many as find room: empty, one of countless runs, or nested."""
    piece = pick(rng, b"<si/>", b"<si><t/></si>", b"<si><r><t>a</t></r></si>", b"<si><phoneticPr fontId='0'/></si>")
    inner = pick(rng, filled(piece), b"<si>" + filled(b"<r><t>a</t></r>") + b"</si>")
    return book(rng, sharedStrings=XML + b"<sst " + MAIN + b">" + inner + b"</sst>")


@kind
def xlsx_billion_laughs(rng):
    depth, times = int(rng.integers(5, 30)), int(rng.integers(2, 12))
    defined = [b'<!ENTITY a0 "' + b"ha" * 50 + b'">']
    defined += [b'<!ENTITY a%d "' % i + b"&a%d;" % (i - 1) * times + b'">' for i in range(1, depth)]
    start = b"<!DOCTYPE x [" + b"".join(defined) + b"]>"
    start = pick(rng, start, b'<!DOCTYPE x [<!ENTITY a%d SYSTEM "file:///dev/zero">]>' % (depth - 1))
    cell = b'<row><c t="inlineStr"><is><t>&a%d;</t></is></c></row>' % (depth - 1)
    return zipped(parts(sheet(cell).replace(XML, XML + start)), rng)


@kind
def xlsx_last_columns(rng):
    """Rows with an empty cell, or none at all, in the last column of a sheet, or in one far beyond."""
    cell = pick(rng, b'<c r="XFD%d"/>', b'<c r="XFD%d"><v></v></c>', b'<c r="ZZZ%d"/>', b'<c r="AZZZ%d"/>')
    return book(rng, *(b'<row r="%d">' % i + cell % i + b"</row>" for i in range(30, near(rng, 20_000))))


@kind
def xlsx_wide_rows(rng):
    cell = pick(rng, b"<c><v>1</v></c>", b"<c/>", b'<c t="b"><v>1</v></c>')
    return book(rng, (b"<row>" + cell * pick(rng, 4096, 16_384, 100_000) + b"</row>") * near(rng, 100))


@kind
def xlsx_rows_far_below(rng):
    """Rows whose number is a billion, decreases, or is none."""
    numbers = pick(rng, (10**9,), (1_048_576,), (1_048_575, 1_048_577), (2, 1, 2), (-1,), (10**30,), ("x",))
    return book(rng, *(f'<row r="{at}"><c><v>1</v></c></row>'.encode() for at in numbers))


@kind
def xlsx_one_endless_cell(rng):
    start, end = pick(
        rng, (b"<c><v>", b"</v></c>"), (b'<c t="inlineStr"><is><t>', b"</t></is></c>"), (b"<c><f>", b"</f></c>"),
        (b"<c r='", b"'/>"), (b'<c t="d"><v>', b"</v></c>"),
    )  # fmt: skip
    return book(rng, b"<row>", start, pick(rng, b"1", b"x") * near(rng, 2e8), end, b"</row>")


@kind
def xlsx_inline_texts(rng):
    run = pick(rng, b"<t>a</t>", b"<r><t>a</t></r>", b"<rPh><t>a</t></rPh>")
    cell = b'<row><c t="inlineStr"><is>' + run * pick(rng, 1, 1000, 1_000_000) + b"</is></c></row>"
    return book(rng, filled(cell, 3e7))


@kind
def xlsx_huge_styles(rng):
    piece, around = pick(
        rng, (b"<xf/>", b"cellXfs"), (b"<font/>", b"fonts"), (b'<numFmt numFmtId="%d" formatCode="0"/>', b"numFmts"),
        (b"<cellStyle name='a' xfId='0'/>", b"cellStyles"), (b"<dxf/>", b"dxfs"), (b"<border/>", b"borders"),
    )  # fmt: skip
    inner = filled(piece.replace(b"%d", b"164"))
    styles = XML + b"<styleSheet " + MAIN + b"><" + around + b">" + inner + b"</" + around + b"></styleSheet>"
    return book(rng, styles=styles)


@kind
def xlsx_huge_workbook_part(rng):
    """Of names, of overrides, or of relations."""
    content = parts(sheet())
    names = b"<definedNames>" + filled(b'<definedName name="a">1</definedName>') + b"</definedNames>"
    part, piece, end = pick(
        rng, ("xl/workbook.xml", names, b"</workbook>"), ("xl/workbook.xml", filled(b"<x/>"), b"</workbook>"),
        ("[Content_Types].xml", filled(b'<Override PartName="/a" ContentType="b"/>'), b"</Types>"),
        ("xl/_rels/workbook.xml.rels", filled(b'<Relationship Id="a" Type="b" Target="c"/>'), b"</Relationships>"),
    )  # fmt: skip
    content[part] = content[part].replace(end, piece + end)
    return zipped(content, rng)


@kind
def xlsx_properties(rng):
    """Of a document: countless, or with dates that are none."""
    core = f'<cp:coreProperties xmlns:cp="{PACKAGE}/metadata/core-properties" xmlns:d="http://purl.org/dc/terms/">'
    piece = pick(rng, b"<d:x/>", b"<d:created>x</d:created>", b"<a>" * 100 + b"</a>" * 100)
    content = parts(sheet())
    content["docProps/core.xml"] = XML + core.encode() + filled(piece, 1.5e7) + b"</cp:coreProperties>"
    override = '<Override PartName="/docProps/core.xml" ContentType="application/vnd.openxmlformats-package.{}"/>'
    kind_of = override.format("core-properties+xml")
    content["[Content_Types].xml"] = content["[Content_Types].xml"].replace(b"</Types>", kind_of.encode() + b"</Types>")
    return zipped(content, rng)


@kind
def xlsx_other_encodings(rng):
    text = sheet(rows(near(rng, 100), 30)).decode()
    code = pick(rng, "utf-7", "utf-16", "utf-16-le", "utf-32", "cp037", "idna", "hex")
    content = text.replace("UTF-8", code.upper()).encode(code if code[:3] in ("utf", "cp0") else "ascii")
    return zipped(parts(content), rng)


@kind
def xlsx_hidden_rows(rng):
    return book(rng, *(b'<row r="%d" hidden="1"><c><v>1</v></c></row>' % i for i in range(30, near(rng, 8e5))))


@kind
def xlsx_hidden_in_a_comment(rng):
    """Tags that a search for hidden rows goes through again and again: with no end, or with a false one."""
    inner = pick(rng, b'hidden="1" ', b'<row hidden="1" ', b"<col ", b' hidden="')
    return book(rng, b"<!-- <row ", filled(inner, pick(rng, 1e6, 1e8)), b"< -->")


@kind
def xlsx_deep_xml(rng):
    tag = pick(rng, b"row", b"c", b"x")
    depth = pick(rng, 1000, 1_000_000)
    return book(rng, b"<%s>" % tag * depth + b"</%s>" % tag * depth)


@kind
def xlsx_many_attributes(rng):
    attributes = b"".join(b' a%d="%d"' % (i, i) for i in range(pick(rng, 1000, 400_000)))
    return book(rng, b"<row" + attributes + b"><c" + attributes + b"/></row>")


@kind
def xlsx_sheet_around_the_rows(rng):
    """Merged cells of the whole sheet, validations and formats of millions of ranges."""
    merged = b"<mergeCells>" + filled(b'<mergeCell ref="A1:XFD1048576"/>') + b"</mergeCells>"
    piece = pick(
        rng, merged, filled(b"<x/>"), b'<dimension ref="A1:XFD1048576"/>', b"<cols>" + filled(b"<col/>") + b"</cols>"
    )
    before = bool(rng.integers(2))
    return zipped(parts(sheet(before=piece if before else b"", after=b"" if before else piece)), rng)


def part_flipped(rng: Rng) -> bytes:
    """Sound book, of which a part is damaged before it is zipped, or the zip after."""
    with zipfile.ZipFile(io.BytesIO(sound_xlsx(60))) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    name = pick(rng, *content)
    return zipped({**content, name: flipped(content[name], rng)}, rng, padded=False).content


KINDS["xlsx_part_flipped"] = lambda rng: File("rig.xlsx", part_flipped(rng))
damage("xlsx", lambda rng: sound_xlsx(near(rng, 60)), "rig.xlsx")
