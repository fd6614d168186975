"""The lab's page: what a lab keeps open at the bench, on the phone and on the wall, and a door for programs.

`flows.server.page_port` holds the port and starts `process` when somebody comes;
`app` puts the pages together from what `now`, `todo`,
`results` and `start` read, and has the answers of people written by the functions that the commands use. All state is
in the lake: the page can be closed, its process killed, and several people may look on.
"""
