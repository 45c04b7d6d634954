"""The lab: pages in a browser that show what the package's own code does, served on the loopback by `server.py`.

A page is a `Page` (`contract.py`) that is named under the entry-point group ``loadid.lab`` of its package, a line in
``pyproject.toml``; another package adds its own in the same way. It has one file of HTML: what stands in ``<main>``,
and one ``<script type="module">`` at its end, which imports ``/lab.js`` and asks the calls of its page. A `Call` names
each parameter with its range and a function that gets them and returns plain data; the function calls the code of the
packages, and neither page nor script computes a result. Nothing is fetched from elsewhere, no style stands in
the markup (the policy of the page forbids both), and every picture is drawn by ``lab.js`` in the looks of ``lab.css``.
"""
