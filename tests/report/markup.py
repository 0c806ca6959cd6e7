"""What HTML has, for tests."""

from html.parser import HTMLParser

VOID = {"meta", "link", "br", "wbr"}


class Markup(HTMLParser):
    """Tags, attributes, text and cells of tables; checks that tags close in order."""

    def __init__(self, html):
        super().__init__()
        self.open, self.attributes, self.tags, self.cells, self.text = [], [], [], [], ""
        self.feed(html)
        self.close()
        assert not self.open

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_starttag(self, tag, attrs):
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "td":
            self.cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data
        if "td" in self.open:
            self.cells[-1] += data
