# SPDX-License-Identifier: MIT
# For the scripts beside it: run_child COMMAND... runs a command that ends when a signal reaches the script alone. A second
# signal ends ernerf without its last save, and a terminal or `timeout` signals a whole process group. So the command runs
# in a session of its own, and the script forwards signals to that session, at most one a second, and ends after it. What
# is forwarded is SIGTERM, because bash lets a program in the background ignore SIGINT.
child='' told='' stopped='' signalled=-1 # told: the child that a signal was forwarded to
stop_child() { # $1: signal
  stopped=$(kill -l "$1")
  [ -n "$child" ] && [ "$SECONDS" -gt "$signalled" ] || return 0
  signalled=$SECONDS told=$child
  kill -s TERM -- "-$child" 2> /dev/null || kill -s TERM "$child" 2> /dev/null || true # the second: its session is not made yet
}
trap 'stop_child INT' INT
trap 'stop_child TERM' TERM
trap 'stop_child HUP' HUP
run_child() {
  local status=0
  [ -z "$stopped" ] || exit $((128 + stopped))
  setsid "$@" &
  child=$!
  [ -z "$stopped" ] || [ "$told" = "$child" ] || stop_child "$stopped" # it came before `child` was known
  wait "$child" || status=$?
  while kill -0 "$child" 2> /dev/null; do # a signal interrupted only the wait
    status=0
    wait "$child" || status=$?
  done
  child=''
  [ -z "$stopped" ] || exit $((128 + stopped))
  return "$status"
}
