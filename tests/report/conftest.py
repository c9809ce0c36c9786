"""The report of the paper's reduced reproduction, and a parser of its page."""

from html.parser import HTMLParser

import pytest


class Page(HTMLParser):
    """Tags with their attributes, those that are open, and the cells of all tables of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.open, self.cells = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br", "link", "input"):
            self.open.append(tag)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if {"td", "th"} & set(self.open):
            self.cells[-1] = " ".join((self.cells[-1] + data).split())

    @property
    def is_self_contained(self):
        """No part comes from elsewhere."""
        starts = {"src": "data:image/", "href": "#"}
        links = [(value, starts[name]) for _, a in self.tags for name, value in a.items() if name in starts]
        active = {"script", "link", "iframe", "object"} & {tag for tag, _ in self.tags}
        return not active and all(value.startswith(start) for value, start in links)


@pytest.fixture(scope="session")
def page_of():
    """Parser of pages."""
    return Page


@pytest.fixture(scope="session")
def written(reproduction, tmp_path_factory):
    """A written report: its folder, and the figures that it has, by name."""
    from mckibben.paper.figures import figures
    from mckibben.paper.page import write_report

    folder, drawn = tmp_path_factory.mktemp("report"), list(figures(reproduction))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mckibben.paper.page.figures", lambda _: drawn)
        write_report(reproduction, folder)
    return folder, {figure.name: figure for figure in drawn}


@pytest.fixture(scope="session")
def drawn(written):
    """All figures of the report, by name."""
    return written[1]


@pytest.fixture(scope="session")
def page(written):
    """The folder of a written report."""
    return written[0]
