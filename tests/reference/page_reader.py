"""What a page is made of, for tests that compare pages or read their words."""

from html.parser import HTMLParser

NASTY_NAMES = (
    '<script>alert("1")</script>',
    '=HYPERLINK("http://x.y") ](javascript:1) `|* ' + "very long " * 60,
    "\N{RIGHT-TO-LEFT OVERRIDE}קומה\x1b[2J\x00 $\\frac{",
)
"""Names of channels as bad as names get."""
NASTY_INPUT = "--><img src=x onerror=alert(1)>"
VOID = {"meta", "br", "img", "input", "link", "hr"}


class Skeleton(HTMLParser):
    """The tags of a page with the names of their attributes, and its text outside pictures."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.tags, self.attributes, self.words, self.open = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        if "svg" not in self.open:
            self.tags.append((tag, tuple(name for name, _ in attrs)))
        self.attributes += [(tag, name, value) for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.attributes += [(tag, name, value) for name, value in attrs]

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "script"} & set(self.open):
            self.words.append(data)

    @property
    def text(self):
        """What a reader reads, a space that does not break as any other."""
        return " ".join(self.words).replace("\N{NO-BREAK SPACE}", " ")


def views(container):
    """Every view of a blueprint's container, those of containers within it included."""
    for part in container.contents:
        yield from views(part) if hasattr(part, "contents") and not hasattr(part, "origin") else [part]
