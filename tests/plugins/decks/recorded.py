"""Options of blocks and keywords of commands that note what readers ask for."""


class Recorded(dict):
    """Options that note the names that are looked up."""

    def __init__(self, options, keyword, asked):
        super().__init__(options)
        self.keyword, self.asked = keyword, asked

    def __getitem__(self, name):
        self.asked.add((self.keyword, name))
        return super().__getitem__(name)

    def get(self, name, default=None):
        self.asked.add((self.keyword, name))
        return super().get(name, default)

    def __contains__(self, name):
        self.asked.add((self.keyword, name))
        return super().__contains__(name)
