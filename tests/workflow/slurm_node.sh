#!/usr/bin/env bash
# Makes this machine a Slurm cluster of one node, for `pytest -m slurm`. For a Debian machine or
# container that may be thrown away, as root: it replaces /etc/slurm/slurm.conf. `slurm_node.sh stop`
# ends the daemons.
set -euo pipefail

stop() {
  for daemon in slurmd slurmctld munged; do
    if [ -e "/run/geoevs-$daemon.pid" ]; then
      pid=$(cat "/run/geoevs-$daemon.pid")
      kill "$pid" 2>/dev/null || true
      while kill -0 "$pid" 2>/dev/null; do sleep 0.1; done
      rm -f "/run/geoevs-$daemon.pid"
    fi
  done
}

if [ "${1:-start}" = stop ]; then
  stop
  exit
fi

if ! (command -v munged && command -v slurmctld && command -v slurmd) >/dev/null; then
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends slurm-wlm munge
fi
stop

if [ ! -s /etc/munge/munge.key ]; then
  dd if=/dev/urandom of=/etc/munge/munge.key bs=1 count=1024 status=none
fi
chown munge: /etc/munge/munge.key
chmod 400 /etc/munge/munge.key
mkdir -p /run/munge /var/spool/slurmctld /var/spool/slurmd /etc/slurm
chown munge: /run/munge
chmod 755 /run/munge

# Neither cgroups nor accounts: they are not there in a container. `slurmd -C` counts sockets, cores,
# threads and memory; 500 MB stay with the system.
node=$(slurmd -C | head -n 1)
memory=$(sed -E 's/.*RealMemory=([0-9]+).*/\1/' <<<"$node")
node=$(sed -E "s/RealMemory=[0-9]+/RealMemory=$((memory - 500))/" <<<"$node")
cat >/etc/slurm/slurm.conf <<CONF
ClusterName=one
SlurmctldHost=$(hostname -s)
SlurmUser=root
SlurmctldPidFile=/run/geoevs-slurmctld.pid
SlurmdPidFile=/run/geoevs-slurmd.pid
StateSaveLocation=/var/spool/slurmctld
SlurmdSpoolDir=/var/spool/slurmd
SlurmctldLogFile=/var/log/slurmctld.log
SlurmdLogFile=/var/log/slurmd.log
AuthType=auth/munge
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
ReturnToService=2
$node State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF

runuser -u munge -- munged --force --pid-file=/run/munge/munged.pid
ln -sf /run/munge/munged.pid /run/geoevs-munged.pid
slurmctld
slurmd
for _ in $(seq 60); do
  if sinfo --noheader --format=%T 2>/dev/null | grep -q idle; then
    sinfo
    exit 0
  fi
  sleep 1
done
echo "no node is idle after a minute; see /var/log/slurmctld.log and /var/log/slurmd.log" >&2
exit 1
