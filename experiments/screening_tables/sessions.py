import json,sys,numpy as np
rows=[json.loads(l) for l in open(sys.argv[1])]
names=sys.argv[2].split(",") if len(sys.argv)>2 else ["whole","regions","few","all"]
d={}
for r in rows: d.setdefault(tuple(r["key"][:2]),{})[r["key"][2]]=r["steps"]
keys=[k for k in d if all(n in d[k] for n in names)]
print(len(keys),"sessions")
for field in ("error","expected","quantile"):
  for T in (4,6,8,10,12,15,18):
    out=[]
    for n in names:
        v=[]
        for k in keys:
            s=[x for x in d[k][n] if x["robot"]<=T]
            v.append(s[-1][field] if s else {"error":0.019,"expected":0.0187,"quantile":0.033}[field])
        out.append((1000*np.mean(v),1000*np.exp(np.mean(np.log(v)))))
    print(field,T,"  ".join(f"{n} {a:.2f}/{g:.2f}" for n,(a,g) in zip(names,out)))
# time until expected error <= thresholds
for th in (0.006,0.004,0.003):
    out=[]
    for n in names:
        t=[]
        for k in keys:
            s=[x["robot"] for x in d[k][n] if x["expected"]<=th]
            t.append(s[0] if s else np.inf)
        out.append(f"{n} median {np.median(t):.1f} reached {np.isfinite(t).mean():.2f}")
    print("expected <=",th,"  ".join(out))
for n in names: print(n,"scans",np.mean([len(d[k][n]) for k in keys]),"converged",np.mean([d[k][n][-1]["converged"] for k in keys]),"robot",np.mean([d[k][n][-1]["robot"] for k in keys]),"final err",1000*np.mean([d[k][n][-1]["error"] for k in keys]),"median ms choice",np.median([x["ms"] for k in keys for x in d[k][n]]))

# ratios to "regions" with intervals, bootstrap over sessions
rng=np.random.default_rng(0)
for T in (6,10,15):
  base={}
  for f in ("expected","error"):
    for n in names:
        v=[]
        for k in keys:
            s=[x for x in d[k][n] if x["robot"]<=T]
            v.append(np.log(s[-1][f] if s else {"error":0.0193,"expected":0.0187}[f]))
        base[n,f]=np.array(v)
  for n in names:
    out=[]
    for f in ("expected","error"):
        diff=base[n,f]-base["regions",f]
        bs=[diff[rng.integers(0,len(keys),len(keys))].mean() for _ in range(2000)]
        out.append(f"{f} {1000*np.exp(base[n,f].mean()):.1f} ratio {np.exp(diff.mean()):.2f} [{np.exp(np.quantile(bs,.025)):.2f} {np.exp(np.quantile(bs,.975)):.2f}]")
    print(T,n,"  ".join(out))
