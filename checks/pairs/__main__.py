# SPDX-License-Identifier: Apache-2.0
"""`python -m checks.pairs`."""

from ros2_ident.threads import one_thread_for_linear_algebra

if __name__ == '__main__':
    # Before NumPy is loaded.
    one_thread_for_linear_algebra()
    from checks.pairs.command import main

    main()
