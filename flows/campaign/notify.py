"""Words to people who are not looking: to the addresses in FAST_NOTIFY, through Apprise (mail, chat, webhooks).

A message that cannot be sent is a line in the log and nothing more: a campaign does not depend on it.
"""

import logging
import os
from dataclasses import dataclass
from typing import Literal

logger = logging.getLogger(__name__)

VARIABLE = "FAST_NOTIFY"
Kind = Literal["needs_you", "done", "stopped", "gap"]
KINDS: tuple[Kind, ...] = ("needs_you", "done", "stopped", "gap")


@dataclass(frozen=True)
class Notifier:
    """Sends messages of the kinds that are wanted; the addresses may hold secrets, so the environment has them."""

    kinds: tuple[Kind, ...] = KINDS

    def send(self, kind: Kind, title: str, text: str) -> bool:
        """Send a message to all addresses; True when every one took it."""
        addresses = os.environ.get(VARIABLE, "").split()
        if kind not in self.kinds or not addresses:
            return False
        import apprise

        level = apprise.NotifyType.FAILURE if kind == "stopped" else apprise.NotifyType.INFO
        sender = apprise.Apprise()
        n_wrong = sum(not sender.add(address) for address in addresses)
        is_sent = bool(sender.notify(body=text, title=title, notify_type=level)) and not n_wrong
        if not is_sent:
            # The addresses themselves stay out of the log.
            logger.warning("the message %r did not reach all %d addresses of %s", title, len(addresses), VARIABLE)
        return is_sent


SILENT = Notifier(())


def notifier(is_virtual: bool, kinds: tuple[Kind, ...] = KINDS, even_virtual: bool = False) -> Notifier:
    """Return the notifier for a bench: a virtual one is silent unless asked to speak."""
    return SILENT if is_virtual and not even_virtual else Notifier(kinds)
