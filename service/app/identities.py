"""Who the live page is, to the servers that it looks at."""

PAGE_URI = "urn:valvemap:dashboard"
PAGE_NAME = "valvemap dashboard"
PAGE_USER = "dashboard"
