"""A server on this machine that writes down what is asked of it, as the text of a program.

It is a process of its own, as GDAL holds Python's lock while it waits for an answer.
"""

from __future__ import annotations

SERVER = """
import http.server, sys, threading
class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        with open(sys.argv[1], "a") as log:
            log.write(self.path + "\\n")
        self.send_response(404)
        self.send_header("Content-Length", "0")
        self.end_headers()
    do_HEAD = do_POST = do_GET
    def log_message(self, *words):
        pass
server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
print(server.server_port, flush=True)
threading.Timer(300, server.shutdown).start()
server.serve_forever()
"""
