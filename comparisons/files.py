"""Writing results whole or not at all."""

from classic_ml.files import check_target, write_whole

__all__ = ["check_target", "write_whole"]
