"""A server of one word, on the listening socket that its parent hands on."""

import socket
import sys

if __name__ == "__main__":
    with socket.socket(fileno=int(sys.argv[1])) as listener:
        while True:
            connection, _ = listener.accept()
            with connection:
                connection.sendall(b"here")
