"""A thread beside Blender's own that does jobs one after the other: plain values in, nothing of Blender's touched."""

import sys
import threading
from collections.abc import Callable, Hashable, Mapping
from typing import Any

Job = Callable[[], object]


class Worker:
    """The thread; it starts with the first job and ends with ``stop``.

    Args:
        name: of the thread.
        failure: a phrase that is printed before the error of a job that fails; the next ones are done nevertheless.
    """

    def __init__(self, name: str, failure: str) -> None:
        self._name, self._failure = name, failure
        self._waiting: dict[Hashable, Job] = {}
        self._is_busy = False
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def ask(self, jobs: Mapping[Any, Job], *, instead: bool = False) -> None:
        """Does jobs by their hashable keys, in their order. One takes the place of a waiting one of the same key.

        Args:
            instead: of all jobs that have not begun.
        """
        with self._changed:
            if instead:
                self._waiting.clear()
            self._waiting.update(jobs)
            if self._waiting and self._thread is None:
                # A daemon, because Python joins other threads before it runs atexit.
                self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
                self._thread.start()
            self._changed.notify_all()

    @property
    def is_idle(self) -> bool:
        """Whether nothing is done and nothing waits."""
        return not self._waiting and not self._is_busy

    def wait(self, seconds: float) -> bool:
        """Waits until everything is done, for scripts and tests; False on timeout."""
        with self._changed:
            return self._changed.wait_for(lambda: self.is_idle, seconds)

    def stop(self) -> None:
        """Ends the thread after its present job. It starts again with the next one."""
        with self._changed:
            thread, self._thread = self._thread, None
            self._waiting.clear()
            self._changed.notify_all()
        if thread is not None:
            thread.join()

    def _work(self) -> None:
        me = threading.current_thread()
        while True:
            with self._changed:
                self._is_busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._waiting or self._thread is not me)
                if self._thread is not me:
                    return
                job = self._waiting.pop(next(iter(self._waiting)))
                self._is_busy = True
            try:
                job()
            except Exception as error:
                print(f"FRoG: {self._failure} ({type(error).__name__}: {error}).", file=sys.stderr)
