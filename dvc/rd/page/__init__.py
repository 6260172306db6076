"""The report as one page that needs nothing else: a file for a browser, on any screen and on paper."""

from dvc.rd.page.build import MAX_PAGE_BYTES, write_page

__all__ = ["MAX_PAGE_BYTES", "write_page"]
