# SPDX-License-Identifier: Apache-2.0
"""What the project uses of astropy.io."""
