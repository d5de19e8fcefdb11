# SPDX-License-Identifier: Apache-2.0
from builtin_interfaces.msg import Time

class Start:
    class Request:
        plan: Time

    class Response:
        success: bool
        message: str
